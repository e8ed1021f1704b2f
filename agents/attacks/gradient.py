"""White-box gradient attacks: an optimizer, an objective, the groups whose views count, a schedule and a budget."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Bool, Float, Shaped
from torch import Tensor

from agents.attacks.constraint import FeasibleSet
from agents.attacks.objectives.untargeted import make_objective
from agents.attacks.pgd import Optimizer, ProjectedGradient, better
from agents.attacks.schedule import BudgetSchedule, Schedule, always, full_budget, make_schedule
from agents.attacks.targets import (
    AttackTargets,
    Objective,
    TargetGroups,
    attack_loss,
    collect_targets,
    make_target_groups,
)
from agents.protocol import Streams, streams
from cp_env.perturbation.ball import make_ball
from cp_env.settings import PRECISIONS, Precision, choose
from cp_env.world.counterfactual import in_precision
from cp_env.world.situation import Situation

BATCH_WORLDS = {"cpu": 8}
"""Worlds that are attacked in one batch, by kind of device: more maps than caches hold are slower, not faster."""

Cells = Callable[[Situation], Shaped[Tensor, "E k H W"]]
"""The cells of each attacker's own map (its grid frame) that it may change: True or 1, else False or 0."""


@dataclass
class GradientAttack:
    """A search for the δ that maximises an objective of the ego's output, through warp, fusion and decoder.

    Args:
        optimizer: how δ is searched for: `ProjectedGradient` (PGD, BIM, MI-FGSM) or `CarliniWagner`.
        random_start: start from a random point of the ball, or from zero.
        restarts: number of starts, of which the best end is kept. Beyond the first, one start is zero and the others
            are random, so more restarts are never weaker than PGD or BIM.
        objective: what is maximised: `both`, `hide`, `spoof`, `remove@…`, `plant@…`, or any `Objective`.
        target_groups: the groups whose views are attacked. "everyone" fused, Eq. (1), suits attackers that know of no
            defence; they never pause. "fused" is the group that the ego fused last; excluded attackers pause. Or any
            `TargetGroups`.
        schedule: the frames in which it attacks; in grace frames every attacker pauses.
        budget_schedule: the share of Δ that may be used, frame by frame.
        where: the cells of the attackers' maps that may be changed; all by default.
        joint: the attackers of a world search together, or each as if the others were benign.
        precision: of the search's own copy of the detector, "bfloat16" for a faster one; the victim's by default. δ and
            the loss stay in single precision.
    """

    optimizer: Optimizer = field(default_factory=ProjectedGradient)
    random_start: bool = True
    restarts: int = 1
    objective: str | Objective = "both"
    target_groups: str | TargetGroups = "everyone"
    schedule: str | Schedule = always
    budget_schedule: BudgetSchedule = full_budget
    where: Cells | None = None
    joint: bool = True
    precision: Precision | None = None
    _streams: list[np.random.Generator] = field(default_factory=list, init=False, repr=False)

    def __post_init__(self) -> None:
        if self.restarts < 1:
            raise ValueError(f"restarts counts the starts and must be at least 1, got {self.restarts}")
        self._objective, self._target_groups = make_objective(self.objective), make_target_groups(self.target_groups)
        self._schedule = make_schedule(self.schedule)
        if self.precision is not None:
            choose("precision", self.precision, PRECISIONS)

    def reset(self, n_worlds: int, rng: Streams) -> None:
        self._streams = streams(n_worlds, rng)

    def act(self, situation: Situation) -> Float[Tensor, "E k C H W"]:
        """The perturbation of every attacker, see `Attack.act`.

        Raises:
            ValueError: target groups, a budget schedule or cells that cannot be used.
        """
        delta = no_perturbation(situation)
        if self.precision is not None:
            situation = in_precision(situation, self.precision)
        targets = collect_targets(situation, self._target_groups, due(situation, self._schedule), joint=self.joint)
        if len(targets.world):
            feasible, worlds = self._feasible_set(targets), targets.world.unique()
            for together in worlds.split(BATCH_WORLDS.get(delta.device.type, len(worlds))):
                mine = torch.isin(targets.world, together)
                part = targets.of(mine)
                delta[part.world[:, None], part.slots] = self._optimum(part, feasible.of(mine), delta)
        return delta

    def _optimum(
        self, targets: AttackTargets, feasible: FeasibleSet, zero: Float[Tensor, "E k C H W"]
    ) -> Float[Tensor, "T m C H W"]:
        """The best δ of all restarts."""
        loss = attack_loss(targets, self._objective)
        from_zero = int(self.random_start)  # the number of the start that is no random one
        starts = (self._start(targets, zero, random=i != from_zero) for i in range(self.restarts))
        best, best_value = self.optimizer(loss, next(starts), feasible)
        for start in starts:
            best, best_value = better(best, best_value, *self.optimizer(loss, start, feasible))
        return best

    def _feasible_set(self, targets: AttackTargets) -> FeasibleSet:
        """The feasible set of the teams' δ."""
        situation = targets.situation
        share = np.asarray(self.budget_schedule(situation.frame), dtype=np.float32)
        if share.shape != situation.frame.shape or not ((share >= 0) & (share <= 1)).all():
            raise ValueError(f"a budget schedule gives a share of the budget, 0 to 1; got {share.tolist()}")
        cells = None
        if self.where is not None:
            mask, shape = self.where(situation), (*situation.attackers.shape, *situation.coverage.shape[-2:])
            if tuple(mask.shape) != shape:
                raise ValueError(f"where must give cells of shape [E, k, H, W] = {shape}, not {tuple(mask.shape)}")
            cells = (mask[targets.world[:, None], targets.slots] > 0).to(situation.coverage)[:, :, None]
        if (share == 1).all():
            return FeasibleSet(situation.norm, situation.budget, cells=cells)
        shares = torch.from_numpy(share).to(situation.coverage)[targets.world]
        return FeasibleSet(situation.norm, situation.budget, shares[:, None, None, None, None], cells)

    def _start(
        self, targets: AttackTargets, zero: Float[Tensor, "E k C H W"], *, random: bool
    ) -> Float[Tensor, "T m C H W"]:
        """The start of the search; zero for attackers without effect, so that they stay there."""
        if not random:
            return zero[targets.world[:, None], targets.slots]
        ball, (k, c, h, w), start = make_ball(targets.situation.norm), zero.shape[1:], torch.zeros_like(zero)
        for e in targets.world.unique().tolist():
            start[e] = ball.random((k, c, h, w), targets.situation.budget, self._streams[e])
        return start[targets.world[:, None], targets.slots] * targets.reach[..., None, None, None]


def no_perturbation(situation: Situation) -> Float[Tensor, "E k C H W"]:
    """No perturbation."""
    return torch.zeros(situation.delta_shape, device=situation.device)


def due(situation: Situation, schedule: Schedule) -> Bool[Tensor, " E"]:
    """The worlds that are attacked in this frame."""
    return situation.active & torch.from_numpy(schedule(situation.frame)).to(situation.active.device)
