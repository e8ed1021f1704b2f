"""coperception's detector with random weights, its slow twin, and three vehicles."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import torch
from torch import Tensor

from cp_env.detector.coperception import FUSIONS, CoperceptionDetector, grid
from cp_env.detector.coperception.checkpoint import Weights
from tests.reference import coperception as twin

AGENTS = 3


EVERYONE = torch.ones(1, AGENTS, dtype=torch.bool)


FIRST = torch.zeros(1, dtype=torch.long)


POSES = ((0.0, 0.0, 0.0), (7.3, -4.1, 0.7), (-12.0, 5.0, -2.0))


LATTICE_POSES = ((0.0, 0.0, 0.0), (6.0, -4.0, 0.0), (-12.0, 22.0, 0.0))


@cache
def state(fusion: str) -> twin.State:
    """A model's random weights; those that only share maps differ in what they fuse by alone."""
    base = twin.random_state("none" if fusion == "none" else "mean", rarity=1.0)
    if fusion not in ("v2vnet", "disconet"):
        return base
    return {**twin.fusion_state(fusion), **base}


@cache
def detector(fusion: str = "mean", resampling: str = "affine") -> CoperceptionDetector:
    named = fusion if fusion in FUSIONS else "mean"
    return CoperceptionDetector(Weights(state(fusion), "a checkpoint"), named, 3, resampling)


@cache
def voxels(agents: int = AGENTS) -> Tensor:
    generator = torch.Generator().manual_seed(1)
    return (torch.rand(agents, 13, 256, 256, generator=generator) < 0.02).to(torch.uint8)


@torch.no_grad()
def ours(
    model: CoperceptionDetector, poses: Sequence[Sequence[float]], groups: Tensor = EVERYONE
) -> tuple[Tensor, Tensor]:
    """Log-odds and codes of the views of the first agent, in coperception's layout."""
    bev = voxels()[: len(poses)]
    received = model.warp(model.encode_grids(bev), torch.tensor(poses))[None]
    return model.with_ego_context(grid.pack(bev[:1])).raw(received, torch.zeros(len(groups), dtype=torch.long), groups)


GROUPS = torch.tensor([[1, 1, 1], [1, 0, 0], [0, 1, 1], [0, 0, 1], [1, 0, 1]], dtype=torch.bool)
