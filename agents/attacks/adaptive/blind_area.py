"""The blind area confusion attack: perturbations where the ego sees nothing for itself."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from agents.attacks.gradient import GradientAttack
from agents.attacks.pgd import ProjectedGradient
from agents.protocol import Attack
from cp_env.types import Sweep
from cp_env.world.situation import Situation

TOLERANCE = 0.05
"""A cell of the ego's map is seen if it differs from an empty map's by more than this share of the largest feature."""


def blind(steps: int = 15, step_size: float = 0.1, random_start: bool = True, target_groups: str = "fused") -> Attack:
    """An attack on the cells that the ego has seen nothing of.

    Threat model: white-box on the detector. The attackers receive the ego's own map as any collaborator does, and read
    from it where its sensor got no return. Of the defence they know that it trusts what the ego sees alone: in the
    blind area a perturbation contradicts nothing. Source: the blind area confusion (BAC) attack of Tao et al. ("GCP:
    Guarded Collaborative Perception with Spatial-Temporal Aware Malicious Agent Detection", 2025), who take the blind
    area from the ego's occupancy. Ours is where the ego's feature map is what an empty sweep would have given.

    Args:
        steps: of the ascent.
        step_size: length of a step in the ball's norm.
        random_start: start from a random point of the ball, or from zero.
        target_groups: the groups whose views are attacked, see `GradientAttack`.

    Returns:
        The attack.
    """
    return GradientAttack(
        ProjectedGradient(steps, step_size), random_start=random_start, target_groups=target_groups, where=unseen
    )


def unseen(situation: Situation) -> Bool[Tensor, "E k H W"]:
    """The cells of each attacker's own map that overlap the ego's and of which the ego has seen nothing.

    Where a pose is rotated or falls between cells, an attacker's cell counts as seen if it touches one that is.
    """
    k = situation.attackers.shape[1]
    pose = torch.take_along_dim(situation.ego_T_sender, situation.attackers[..., None], 1)
    seen = seen_by_ego(situation).to(situation.coverage)[:, None].expand(-1, k, -1, -1)
    both = torch.stack([seen, torch.ones_like(seen)], dim=2)
    there = situation.detector.warp(both, _inverse(pose))
    return (there[:, :, 0] == 0) & (there[:, :, 1] > 0)


def seen_by_ego(situation: Situation) -> Bool[Tensor, "E H W"]:
    """The cells in which the ego's own map differs from an empty one, and their neighbours."""
    nothing = Sweep(np.zeros((0, 3), dtype=np.float32), np.zeros(3, dtype=np.float32))
    with torch.no_grad():
        empty = situation.detector.encode([nothing])
    own = situation.received[:, 0]
    differs = (own - empty).abs().amax(1) > TOLERANCE * own.abs().amax((1, 2, 3))[:, None, None]
    near: Tensor = functional.max_pool2d(differs.float()[:, None], kernel_size=3, stride=1, padding=1)[:, 0]
    return near > 0


def _inverse(pose: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n 3"]:
    """sender_T_ego from ego_T_sender."""
    x, y, yaw = pose.unbind(-1)
    cos, sin = torch.cos(yaw), torch.sin(yaw)
    return torch.stack([-(cos * x + sin * y), sin * x - cos * y, -yaw], dim=-1)
