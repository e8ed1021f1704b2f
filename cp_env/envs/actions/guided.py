"""The action map that steers the detector's own gradient: white-box."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from cp_env.detector.model.decoder import Dense, cell_centres
from cp_env.envs.actions.ascent import climb, parts
from cp_env.envs.actions.base import ActionMap
from cp_env.perturbation.ball import make_ball
from cp_env.perturbation.objective import Loss, distance_from
from cp_env.perturbation.output import attacked_output
from cp_env.world.counterfactual import rounded
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

    def __init__(self, channels: int, size: int, precision: str | None = None) -> None:
        """A map for shared maps of (channels, size, size), whose gradients are of a precision or the detector's own."""
        super().__init__((self.size,))
        self._precision = precision
        self._last: Float[Tensor, "E k C H W"] | None = None
        self._stale: list[int] = []

    def reset(self, worlds: list[int]) -> None:
        self._stale += worlds

    def __call__(self, actions: Float[np.ndarray, "E k *a"], situation: Situation) -> Float[Tensor, "E k C H W"]:
        guidance = self._guidance(actions, situation)
        delta = self._steered(guidance, situation)
        self._keep(delta, guidance.fires * situation.active[:, None])
        return delta

    def _guidance(self, steering: Float[np.ndarray, "E k 8"], situation: Situation) -> Guidance:
        """What eight numbers of every slot mean in this frame."""
        return Guidance.read(torch.from_numpy(steering).to(situation.device), situation.detector.extent)

    def _steered(self, guidance: Guidance, situation: Situation) -> Float[Tensor, "E k C H W"]:
        """The δ that the attackers want; zero for those that do not fire."""
        last, ball = self._carried(situation), make_ball(situation.norm)
        radius = guidance.strength * situation.budget * (guidance.fires * situation.active[:, None])
        delta = torch.empty_like(last)
        for part, share, reach in parts(delta, guidance.persistence, radius):
            ball.project(torch.mul(last[part], share, out=delta[part]), reach, out=delta[part])
        useful = situation.fused.gather(1, situation.attackers) & (radius > 0)
        if bool(useful.any()):
            self._ascend(delta, radius, useful, guidance, situation)
        return delta

    def _carried(self, situation: Situation) -> Float[Tensor, "E k C H W"]:
        """The perturbation that every slot sent last; 0 if its episode has just begun."""
        if self._last is None:
            self._last = torch.zeros(situation.delta_shape, device=situation.device)
        self._last[self._stale] = 0
        self._stale = []
        return self._last

    def _keep(self, delta: Float[Tensor, "E k C H W"], fires: Float[Tensor, "E k"]) -> None:
        """Keep what was sent; an attacker that pauses keeps its last perturbation."""
        assert self._last is not None
        for part, fired in parts(delta, fires):
            if not isinstance(fired, float):
                torch.where(fired > 0, delta[part], self._last[part], out=self._last[part])
            elif fired > 0:
                self._last[part] = delta[part]

    def _ascend(
        self,
        delta: Float[Tensor, "E k C H W"],
        radius: Float[Tensor, "E k"],
        useful: Bool[Tensor, "E k"],
        guidance: Guidance,
        situation: Situation,
    ) -> None:
        """Move δ, in place, by `steps` steps of ascent; only in worlds where a perturbation can still reach the ego."""
        if self._precision is not None:
            situation = replace(situation, detector=rounded(situation.detector, self._precision))
        busy = useful.any(1).nonzero()[:, 0]
        weights = guidance.fires[busy] * useful[busy]
        weights = weights / weights.sum(1, keepdim=True).clamp(min=1)
        where = (_aim(guidance, situation)[busy] * weights[..., None, None]).sum(1)
        spoof, drift = (weights * guidance.spoof[busy]).sum(1), (weights * guidance.drift[busy]).sum(1)
        for rows in torch.arange(len(busy)).split(TOGETHER.get(delta.device.type, len(busy))):
            worlds, few = busy[rows], slice(int(rows[0]), int(rows[-1]) + 1)
            clean = Dense(*(one.index_select(0, worlds) for one in (situation.clean.logits, situation.clean.boxes)))
            damage = distance_from(clean, hide=1 - spoof[few], spoof=spoof[few], drift=drift[few], where=where[few])
            if _consecutive(worlds):  # as where all attack: nothing is copied
                self._climb(delta[int(worlds[0]) : int(worlds[-1]) + 1], radius[worlds], worlds, damage, situation)
            else:
                mine = delta.index_select(0, worlds)
                self._climb(mine, radius[worlds], worlds, damage, situation)
                delta.index_copy_(0, worlds, mine)

    def _climb(
        self,
        delta: Float[Tensor, "B k C H W"],
        radius: Float[Tensor, "B k"],
        worlds: Int[Tensor, " B"],
        damage: Loss,
        situation: Situation,
    ) -> None:
        """The ascent in some worlds, δ in place."""
        perceive = attacked_output(
            situation.ego_detector(worlds),
            situation.received,
            situation.coverage,
            situation.attackers[worlds],
            torch.take_along_dim(situation.ego_T_sender[worlds], situation.attackers[worlds][..., None], 1),
            torch.arange(len(worlds), device=worlds.device),
            situation.fused[worlds],
            worlds=worlds,
            sending=radius > 0,
        )
        climb(delta, radius, perceive, damage, situation.norm, self.steps)


TOGETHER = {"cpu": 16}
"""Worlds whose gradient is taken in one go, by kind of device; all of them elsewhere."""


def _consecutive(rows: Int[Tensor, " B"]) -> bool:
    """Whether rows, ascending, follow one another."""
    return int(rows[-1] - rows[0]) + 1 == len(rows)


def _aim(guidance: Guidance, situation: Situation) -> Float[Tensor, "E k h w"]:
    """Gaussian weights over the score map, at most 1."""
    centre = cell_centres(situation.clean.logits.shape[-1], situation.detector.extent, situation.clean.logits)
    dx = centre[None, None, None, :] - guidance.x[..., None, None]
    dy = centre[None, None, :, None] - guidance.y[..., None, None]
    return torch.exp(-(dx**2 + dy**2) / (2 * guidance.width[..., None, None] ** 2))
