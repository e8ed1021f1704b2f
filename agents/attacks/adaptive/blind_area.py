"""Lies where the ego cannot see for itself."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from agents.attacks.gradient import Ascent
from agents.attacks.pgd import Steepest
from agents.protocol import Attacker
from cp_env.types import Sweep
from cp_env.world.situation import Situation

TOLERANCE = 0.05
"""A cell of the ego's map is seen if it differs from an empty map's by more than this share of the largest feature."""


def blind(steps: int = 15, step_size: float = 0.1, random_start: bool = True, audience: str = "fused") -> Attacker:
    """Liars who touch only those cells of their maps that the ego has seen nothing of.

    Threat model: white-box on the detector, and the liars receive the ego's own map as any collaborator does; from it
    they read where its sensor got no return. Of the defence they know that it trusts what the ego sees alone: there a
    lie contradicts nothing. Source: the blind area confusion (BAC) attack of Tao et al. ("GCP: Guarded Collaborative
    Perception with Spatial-Temporal Aware Malicious Agent Detection", 2025), who take the blind area from the ego's
    occupancy; ours is where its feature map is what an empty sweep would have given.
    """
    return Ascent(Steepest(steps, step_size), random_start=random_start, audience=audience, where=unseen)


def unseen(situation: Situation) -> Bool[Tensor, "E k H W"]:
    """The cells of each liar's own map that lie on the ego's and of which the ego has seen nothing.

    Where a pose turns or falls between cells, a liar's cell counts as seen if it touches one that is.
    """
    k = situation.attackers.shape[1]
    pose = torch.take_along_dim(situation.ego_T_sender, situation.attackers[..., None], 1)
    seen = seen_by_ego(situation).to(situation.received)[:, None].expand(-1, k, -1, -1)
    both = torch.stack([seen, torch.ones_like(seen)], dim=2)
    there = situation.detector.warp(both, _inverse(pose))
    return (there[:, :, 0] == 0) & (there[:, :, 1] > 0)


def seen_by_ego(situation: Situation) -> Bool[Tensor, "E H W"]:
    """The cells of which the ego's own map says something, and their neighbours."""
    nothing = Sweep(np.zeros((0, 3), dtype=np.float32), np.zeros(3, dtype=np.float32))
    with torch.no_grad():
        empty = situation.detector.encode([nothing])
    own = situation.received[:, 0]
    told = (own - empty).abs().amax(1) > TOLERANCE * own.abs().amax((1, 2, 3))[:, None, None]
    near: Tensor = functional.max_pool2d(told.float()[:, None], kernel_size=3, stride=1, padding=1)[:, 0]
    return near > 0


def _inverse(pose: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n 3"]:
    """sender_T_ego from ego_T_sender."""
    x, y, yaw = pose.unbind(-1)
    cos, sin = torch.cos(yaw), torch.sin(yaw)
    return torch.stack([-(cos * x + sin * y), sin * x - cos * y, -yaw], dim=-1)
