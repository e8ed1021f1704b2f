"""One projected-ascent loop. PGD starts at random in the ball, BIM at zero: arguments, not classes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from agents.ball import Ball, make_ball
from agents.objective import Objective
from agents.protocol import Streams, streams
from agents.schedule import Schedule, always
from cp_env.detector.adversarial import lies
from cp_env.detector.decoder import Dense
from cp_env.world import Situation

AUDIENCES = ("everyone", "fused")
Goal = Callable[[Dense, Dense], Float[Tensor, " B"]]
Loss = Callable[[Float[Tensor, "B k C H W"]], Float[Tensor, " B"]]


def ascend(
    loss: Loss, start: Float[Tensor, "B k C H W"], *, ball: Ball, budget: float, steps: int, step_size: float
) -> tuple[Float[Tensor, "B k C H W"], Float[Tensor, " B"]]:
    """The best iterate of each world and its loss, after `steps` steepest steps of length `step_size` from `start`."""
    delta = ball.project(start, budget)
    best, best_loss = delta, torch.full((len(start),), -torch.inf, device=start.device)
    for step in range(steps + 1):
        leaf = delta.detach().requires_grad_(step < steps)
        value = loss(leaf)
        better = value.detach() > best_loss
        best = torch.where(better[:, None, None, None, None], leaf.detach(), best)
        best_loss = torch.where(better, value.detach(), best_loss)
        if step < steps:
            (gradient,) = torch.autograd.grad(value.sum(), leaf)
            delta = ball.project(leaf.detach() + step_size * ball.steepest(gradient), budget)
    return best, best_loss


@dataclass
class Ascent:
    """Projected gradient ascent on `objective`, joint over a world's liars, through warp, fusion and decoder.

    Defaults are the paper's (Sec. 11.1): 15 steps of 0.1, an absolute length in the ball's norm. `audience` is the
    group whose view is attacked: "everyone" fused, Eq. (1), by liars that know of no defence and never pause; or those
    the ego "fused" last, by liars that do: the excluded among them have no effect and pause. In grace frames all pause.
    """

    steps: int = 15
    step_size: float = 0.1
    random_start: bool = True
    objective: Goal = field(default_factory=Objective)
    audience: str = "everyone"
    schedule: Schedule = always
    _streams: list[np.random.Generator] = field(default_factory=list, init=False, repr=False)

    def __post_init__(self) -> None:
        if self.audience not in AUDIENCES:
            raise ValueError(f"audience must be one of {AUDIENCES}, got {self.audience!r}")
        if self.steps < 0 or not self.step_size > 0:
            raise ValueError(f"ascent needs steps >= 0 and step_size > 0, got {self.steps} and {self.step_size}")

    def reset(self, n_worlds: int, rng: Streams) -> None:
        self._streams = streams(n_worlds, rng)

    def act(self, situation: Situation) -> Float[Tensor, "E k C H W"]:
        """See `Attacker.act`."""
        delta = silence(situation)
        groups = situation.fused if self.audience == "fused" else torch.ones_like(situation.fused)
        liars = groups.gather(1, situation.attackers)
        worlds = torch.nonzero(_due(situation, self.schedule) & liars.any(1)).flatten()
        if len(worlds):
            start = self._start(worlds, delta[worlds], make_ball(situation.norm), situation.budget)
            start = start * liars[worlds, :, None, None, None]
            loss = attack_loss(situation, worlds, groups[worlds], self.objective)
            delta[worlds] = self._search(loss, start, situation.norm, situation.budget)
        return delta

    def _search(
        self, loss: Loss, start: Float[Tensor, "B k C H W"], norm: str, budget: float
    ) -> Float[Tensor, "B k C H W"]:
        """The worst δ found for each world."""
        best, _ = ascend(loss, start, ball=make_ball(norm), budget=budget, steps=self.steps, step_size=self.step_size)
        return best

    def _start(self, worlds: Tensor, zero: Float[Tensor, "B k C H W"], ball: Ball, budget: float) -> Tensor:
        if not self.random_start:
            return zero
        shape = (zero.shape[1], zero.shape[2], zero.shape[3], zero.shape[4])
        return torch.stack([ball.random(shape, budget, self._streams[e]) for e in worlds.tolist()]).to(zero)


@dataclass
class Noise:
    """Random perturbations, uniform in the L∞ ball: what no gradient buys."""

    schedule: Schedule = always
    _streams: list[np.random.Generator] = field(default_factory=list, init=False, repr=False)

    def reset(self, n_worlds: int, rng: Streams) -> None:
        self._streams = streams(n_worlds, rng)

    def act(self, situation: Situation) -> Float[Tensor, "E k C H W"]:
        """See `Attacker.act`."""
        delta = silence(situation)
        ball, (k, c, h, w) = make_ball(situation.norm), delta.shape[1:]
        for e in _due(situation, self.schedule).nonzero().flatten().tolist():
            delta[e] = ball.random((k, c, h, w), situation.budget, self._streams[e])
        return delta


class Silence:
    """Liars that do not lie."""

    def reset(self, n_worlds: int, rng: Streams) -> None:
        del n_worlds, rng

    def act(self, situation: Situation) -> Float[Tensor, "E k C H W"]:
        """See `Attacker.act`."""
        return silence(situation)


def attack_loss(situation: Situation, worlds: Int[Tensor, " B"], groups: Bool[Tensor, "B N"], objective: Goal) -> Loss:
    """`objective` of the ego's view of `groups` in `worlds` if the liars add δ to what they send, Eq. (1), against the
    view that it would have if nobody lied."""
    liars = situation.attackers[worlds]
    pose = torch.take_along_dim(situation.ego_T_sender[worlds], liars[..., None], 1)
    perceive = lies(situation.eyes(worlds), situation.received[worlds], situation.coverage[worlds], groups, liars, pose)
    clean = Dense(situation.clean.logits[worlds], situation.clean.boxes[worlds])
    return lambda delta: objective(perceive(delta), clean)


def silence(situation: Situation) -> Float[Tensor, "E k C H W"]:
    """No perturbation."""
    worlds, k = situation.attackers.shape
    return situation.received.new_zeros((worlds, k, *situation.received.shape[2:]))


def _due(situation: Situation, schedule: Schedule) -> Bool[Tensor, " E"]:
    """The worlds in which this is a frame for lying."""
    return situation.active & torch.from_numpy(schedule(situation.frame)).to(situation.active.device)
