"""Action maps: a Box in [-1, 1] becomes a perturbation δ with ‖δ‖ ≤ Δ.

    full     the raw map (C, H, W): gradient attackers act through this same door (PPO on it diverges).
    basis    a few coefficients on fixed directions: black-box.
    guided   eight numbers that steer the detector's own gradient: white-box; what PPO learns on.
    quiet    the same, held back so that the ego's view resembles its last output (`cp_env.quiet`).

Every map clips actions to [-1, 1]; NaN, infinity and wrong shapes are a ValueError.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import gymnasium
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from cp_env.channel import project
from cp_env.detector.adversarial import distance_from, lies
from cp_env.detector.decoder import cell_centres
from cp_env.settings import ACTIONS, choose
from cp_env.world import Situation


class ActionMap(ABC):
    """One slot's action space, and the way from all slots' actions to all perturbations."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.space = gymnasium.spaces.Box(-1.0, 1.0, shape, np.float32)

    def reset(self, worlds: list[int]) -> None:  # noqa: B027 (most maps carry nothing over)
        """New episodes begin in `worlds`: forget what was carried over from frame to frame there."""

    def checked(self, actions: np.ndarray, n: tuple[int, int]) -> Float[np.ndarray, "E k *a"]:
        """The actions of n = (E, k) slots, clipped to [-1, 1]; ValueError for a wrong shape, NaN or infinity."""
        array = np.asarray(actions, dtype=np.float32)
        shape = (*n, *self.space.shape)
        if array.shape != shape:
            raise ValueError(f"an action must have shape {self.space.shape}; together {shape}, not {array.shape}")
        if not np.isfinite(array).all():
            raise ValueError("an action must be finite, but it holds NaN or infinity; check the policy")
        return np.clip(array, -1.0, 1.0)

    @abstractmethod
    def __call__(self, actions: Float[np.ndarray, "E k *a"], situation: Situation) -> Float[Tensor, "E k C H W"]:
        """The perturbations, inside the ball, in the senders' grid frames."""


class Full(ActionMap):
    """δ = Δ · action, entry by entry; for the L2 ball the result is then shortened to Δ."""

    def __init__(self, channels: int, size: int) -> None:
        super().__init__((channels, size, size))

    def __call__(self, actions: Float[np.ndarray, "E k *a"], situation: Situation) -> Float[Tensor, "E k C H W"]:
        delta = torch.from_numpy(actions).to(situation.received.device) * situation.budget
        return project(delta, situation.budget, situation.norm)


class Basis(ActionMap):
    """δ = Δ · clip(Σ_j a_j B_j): sixteen fixed directions, a sign per channel times a smooth plane wave over the map.

    The directions come from a seed of their own, so an action means the same in every environment; they need no
    knowledge of the detector (black-box). Our choice: the paper has no such attack.
    """

    count = 16

    def __init__(self, channels: int, size: int) -> None:
        super().__init__((self.count,))
        rng = np.random.default_rng(0)
        signs = rng.choice([-1.0, 1.0], (self.count, channels, 1, 1))
        wave = rng.uniform(-np.pi, np.pi, (self.count, 3)) * np.array([4 / size, 4 / size, 1.0])
        row, column = np.mgrid[:size, :size]
        phase = wave[:, 0, None, None] * row + wave[:, 1, None, None] * column + wave[:, 2, None, None]
        self._directions = torch.from_numpy((signs * np.cos(phase)[:, None]).astype(np.float32))

    def __call__(self, actions: Float[np.ndarray, "E k *a"], situation: Situation) -> Float[Tensor, "E k C H W"]:
        device = situation.received.device
        mixed = torch.einsum("eka,achw->ekchw", torch.from_numpy(actions).to(device), self._directions.to(device))
        return project(mixed.clamp(-1, 1) * situation.budget, situation.budget, situation.norm)


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
        guidance = Guidance.read(torch.from_numpy(actions).to(situation.received.device), situation.detector.extent)
        start = self._carried(situation)
        fires = (guidance.fires * situation.active[:, None])[..., None, None, None]
        radius = (guidance.strength * situation.budget)[..., None, None, None] * fires
        delta = _shrink(start * guidance.persistence[..., None, None, None], radius, situation.norm)
        useful = situation.fused.gather(1, situation.attackers) & (radius.flatten(1) > 0)
        if bool(useful.any()):
            delta = self._ascend(delta, radius, useful, guidance, situation)
        self._last = torch.where(fires > 0, delta, start)  # who pauses remembers its last lie
        return delta

    def _carried(self, situation: Situation) -> Float[Tensor, "E k C H W"]:
        """What every slot sent last, or 0 if its episode has just begun."""
        if self._last is None:
            self._last = situation.received.new_zeros((*situation.attackers.shape, *situation.received.shape[2:]))
        self._last[self._stale] = 0
        self._stale = []
        return self._last

    def _ascend(
        self, delta: Tensor, radius: Tensor, useful: Tensor, guidance: Guidance, situation: Situation
    ) -> Float[Tensor, "E k C H W"]:
        busy = useful.any(1).nonzero()[:, 0]  # worlds in which somebody's lie can still reach the ego
        weights = guidance.fires[busy] * useful[busy]
        weights = weights / weights.sum(1, keepdim=True).clamp(min=1)
        attackers = situation.attackers[busy]
        poses = situation.ego_T_sender[busy].gather(1, attackers[..., None].expand(-1, -1, 3))
        clean = type(situation.clean)(situation.clean.logits[busy], situation.clean.boxes[busy])
        where = (_aim(guidance, situation)[busy] * weights[..., None, None]).sum(1)
        spoof, drift = (weights * guidance.spoof[busy]).sum(1), (weights * guidance.drift[busy]).sum(1)
        moving, reach = delta[busy], radius[busy]
        perceive = lies(
            situation.eyes(busy),
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
            step = _steepest(gradient, situation.norm) * reach * (2.0 / self.steps)
            moving = _shrink(moving.detach() + step, reach, situation.norm)
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


def _steepest(gradient: Float[Tensor, "E k C H W"], norm: str) -> Float[Tensor, "E k C H W"]:
    """The direction of unit norm that gains most, where there is anything to gain."""
    if norm == "linf":
        cells = gradient.abs().amax(2, keepdim=True)
        return gradient.sign() * (cells > FAINT * cells.amax((3, 4), keepdim=True))
    length = gradient.flatten(2).norm(dim=2)[..., None, None, None]
    return gradient / length.clamp(min=1e-12)


def _shrink(
    delta: Float[Tensor, "E k C H W"], radius: Float[Tensor, "E k 1 1 1"], norm: str
) -> Float[Tensor, "E k C H W"]:
    """Project onto balls of each slot's own radius."""
    if norm == "linf":
        return torch.minimum(torch.maximum(delta, -radius), radius)
    length = delta.flatten(2).norm(dim=2)[..., None, None, None].clamp(min=1e-12)
    return delta * (radius / length).clamp(max=1.0)


def make_action(name: str, channels: int, size: int) -> ActionMap:
    """The action map called `name`, for shared maps of (channels, size, size)."""
    from cp_env.quiet import Quiet  # here, because it builds on `Guided`

    maps: dict[str, type[Full | Basis | Guided]] = {"full": Full, "basis": Basis, "guided": Guided, "quiet": Quiet}
    return maps[choose("action map", name, ACTIONS)](channels, size)
