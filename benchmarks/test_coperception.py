"""What a verification costs with coperception's detector, one torch thread: `pytest benchmarks/test_coperception.py`.

Their way is a full forward of six agents, of which one view is used: everyone encoded, fused and decoded
(`tests/reference/coperception.py`). Ours encodes each agent once a frame and decodes the ego alone. Weights are random,
in their format; what is timed does not depend on them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch

from cp_env.detector.coperception import CoperceptionDetector, grid
from cp_env.detector.coperception.checkpoint import Weights
from tests.reference import coperception as twin

AGENTS = 6
FUSIONS = ("mean", "v2vnet", "disconet")
Benchmark = Callable[..., Any]


@pytest.fixture(scope="module")
def bev() -> torch.Tensor:
    return (torch.rand(AGENTS, 13, 256, 256, generator=torch.Generator().manual_seed(0)) < 0.02).to(torch.uint8)


@pytest.fixture(scope="module", params=FUSIONS)
def state(request: pytest.FixtureRequest) -> tuple[str, twin.State]:
    return request.param, twin.random_state(request.param)


@torch.inference_mode()
def test_their_way(benchmark: Benchmark, state: tuple[str, twin.State], bev: torch.Tensor) -> None:
    """A view of one group of six: one forward of all."""
    poses = torch.from_numpy(np.tile(np.eye(4), (AGENTS, AGENTS, 1, 1)))
    benchmark.pedantic(twin.forward, (state[1], state[0], bev.float(), poses), rounds=5, warmup_rounds=1)  # type: ignore[attr-defined]


def ours(state: tuple[str, twin.State], bev: torch.Tensor) -> tuple[CoperceptionDetector, torch.Tensor]:
    detector = CoperceptionDetector(Weights(state[1], "a checkpoint"), state[0], 3, "affine")
    return detector.with_ego_context(grid.pack(bev[:1])), detector.encode_grids(bev)[None]


@torch.inference_mode()
def test_a_verification(benchmark: Benchmark, state: tuple[str, twin.State], bev: torch.Tensor) -> None:
    """A view of one group of six, the frame being encoded."""
    model, received = ours(state, bev)
    world, everyone = torch.zeros(1, dtype=torch.long), torch.ones(1, AGENTS, dtype=torch.bool)
    covered = torch.ones(1, AGENTS, 32, 32)
    benchmark.pedantic(model.perceive, (received, covered, world, everyone), rounds=10, warmup_rounds=1)  # type: ignore[attr-defined]


@torch.inference_mode()
def test_a_frame(benchmark: Benchmark, state: tuple[str, twin.State], bev: torch.Tensor) -> None:
    """What comes before the first view of a frame: six sweeps encoded, the ego's own layers made ready."""
    model, received = ours(state, bev)
    world, alone = torch.zeros(1, dtype=torch.long), torch.eye(1, AGENTS, dtype=torch.bool)

    def frame() -> None:
        model._skips.clear()
        model.encode_grids(bev)
        model.raw(received, world, alone)

    benchmark.pedantic(frame, rounds=3, warmup_rounds=1)  # type: ignore[attr-defined]
