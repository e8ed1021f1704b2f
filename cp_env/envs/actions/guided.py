"""The action map that steers the detector's own gradient: white-box."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from cp_env.detector.model.decoder import cell_centres
from cp_env.envs.actions.base import ActionMap
from cp_env.perturbation.ball import ascend, make_ball
from cp_env.perturbation.objective import attacked_output, distance_from
from cp_env.world.situation import Situation


@dataclass(frozen=True, eq=False)
class Guidance:
    """A guided action, number by number. A team shares the mean of its firing members' aims; strength is each one's."""

    strength: Float[Tensor, "E k"]  # radius of the ball used, as a share of Δ
    spoof: Float[Tensor, "E k"]  # 0 only hides, 1 only spoofs
    drift: Float[Tensor, "E k"]  # weight of moving boxes
    x: Float[Tensor, "E k"]  # where to aim, ego frame, m
    y: Float[Tensor, "E k"]
    width: Float[Tensor, "E k"]  # standard deviation of the aim, m
    persistence: Float[Tensor, "E k"]  # share of the last frame's δ to start from
    fires: Float[Tensor, "E k"]  # 1 if it attacks in this frame

    @classmethod
    def read(cls, actions: Float[Tensor, "E k 8"], extent: float) -> Guidance:
        """From numbers in [-1, 1]; 0 is the middle of every range, and fires."""
        unit = (actions + 1) / 2
        return cls(
            strength=unit[..., 0],
            spoof=unit[..., 1],
            drift=unit[..., 2],
            x=actions[..., 3] * extent,
            y=actions[..., 4] * extent,
            width=4.0 * 16.0 ** unit[..., 5],
            persistence=unit[..., 6],
            fires=(actions[..., 7] >= 0).float(),
        )


class Guided(ActionMap):
    """Eight numbers steer `steps` steps of projected ascent on the adversarial loss (Eq. 2), from the last δ on.

    In order: strength, hide against spoof, drift, aim x, aim y, aim width, persistence, gate (attack if >= 0). The
    ascent runs on the view the ego is expected to fuse.
    """

    size = 8
    steps = 3

    def __init__(self, channels: int, size: int) -> None:
        super().__init__((self.size,))
        self._last: Float[Tensor, "E k C H W"] | None = None
        self._stale: list[int] = []

    def reset(self, worlds: list[int]) -> None:
        self._stale += worlds

    def __call__(self, actions: Float[np.ndarray, "E k *a"], situation: Situation) -> Float[Tensor, "E k C H W"]:
        guidance = Guidance.read(torch.from_numpy(actions).to(situation.device), situation.detector.extent)
        start = self._carried(situation)
        fires = (guidance.fires * situation.active[:, None])[..., None, None, None]
        radius = (guidance.strength * situation.budget)[..., None, None, None] * fires
        delta = make_ball(situation.norm).project(start * guidance.persistence[..., None, None, None], radius)
        useful = situation.fused.gather(1, situation.attackers) & (radius.flatten(1) > 0)
        if bool(useful.any()):
            delta = self._ascend(delta, radius, useful, guidance, situation)
        self._last = torch.where(fires > 0, delta, start)  # an attacker that pauses keeps its last perturbation
        return delta

    def _carried(self, situation: Situation) -> Float[Tensor, "E k C H W"]:
        """The perturbation that every slot sent last; 0 if its episode has just begun."""
        if self._last is None:
            self._last = torch.zeros(situation.delta_shape, device=situation.device)
        self._last[self._stale] = 0
        self._stale = []
        return self._last

    def _ascend(
        self, delta: Tensor, radius: Tensor, useful: Tensor, guidance: Guidance, situation: Situation
    ) -> Float[Tensor, "E k C H W"]:
        busy = useful.any(1).nonzero()[:, 0]  # worlds in which a perturbation can still reach the ego
        weights = guidance.fires[busy] * useful[busy]
        weights = weights / weights.sum(1, keepdim=True).clamp(min=1)
        attackers = situation.attackers[busy]
        poses = situation.ego_T_sender[busy].gather(1, attackers[..., None].expand(-1, -1, 3))
        clean = type(situation.clean)(situation.clean.logits[busy], situation.clean.boxes[busy])
        where = (_aim(guidance, situation)[busy] * weights[..., None, None]).sum(1)
        spoof, drift = (weights * guidance.spoof[busy]).sum(1), (weights * guidance.drift[busy]).sum(1)
        moving, reach, ball = delta[busy], radius[busy], make_ball(situation.norm)
        perceive = attacked_output(
            situation.ego_detector(busy),
            situation.received[busy],
            situation.coverage[busy],
            attackers,
            poses,
            torch.arange(len(busy), device=busy.device),
            situation.fused[busy],
        )
        damage = distance_from(clean, hide=1 - spoof, spoof=spoof, drift=drift, where=where)
        for _ in range(self.steps):
            moving = moving.detach().requires_grad_()
            with torch.enable_grad():
                (gradient,) = torch.autograd.grad(damage(perceive(moving)).sum(), moving)
            direction = ball.steepest(gradient) * _strong(gradient, situation.norm)
            moving = ascend(ball, moving.detach(), direction * reach, 2.0 / self.steps, reach)
        result = delta.clone()
        result[busy] = moving
        return result


def _aim(guidance: Guidance, situation: Situation) -> Float[Tensor, "E k h w"]:
    """Gaussian weights over the score map, at most 1."""
    centre = cell_centres(situation.clean.logits.shape[-1], situation.detector.extent, situation.clean.logits)
    dx = centre[None, None, None, :] - guidance.x[..., None, None]
    dy = centre[None, None, :, None] - guidance.y[..., None, None]
    return torch.exp(-(dx**2 + dy**2) / (2 * guidance.width[..., None, None] ** 2))


FAINT = 0.01
"""Cells whose gradient is below this share of the strongest cell's are left alone: a sign knows no magnitude, and
without this a narrow aim would still fill the whole map."""


def _strong(gradient: Float[Tensor, "E k C H W"], norm: str) -> Float[Tensor, "E k 1 H W"] | float:
    """1 in the cells whose gradient is not faint; a direction of the L2 ball keeps its magnitudes and needs no mask."""
    if norm != "linf":
        return 1.0
    cells = gradient.abs().amax(2, keepdim=True)
    return (cells > FAINT * cells.amax((3, 4), keepdim=True)).to(gradient)
