"""The targets of an attack: teams of attackers that optimise together, and the views of the ego that they attack."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from cp_env.detector.model.decoder import Dense
from cp_env.perturbation.output import attacked_output
from cp_env.world.situation import Situation

GroupDistribution = tuple[Bool[Tensor, "E S N"], Float[Tensor, "E S"]]
TargetGroups = Callable[[Situation], GroupDistribution]
"""From a situation to S groups for each world whose views are attacked, and the weight of each in the expectation.

A weight of 0 leaves a group out, so worlds may have different numbers of groups. The weights need not sum to 1.
"""

ViewLoss = Callable[[Dense], Float[Tensor, " B"]]
Loss = Callable[[Float[Tensor, "T m C H W"]], Float[Tensor, " T"]]


@dataclass(frozen=True, eq=False)
class AttackTargets:
    """T teams of m attackers each, and B views that they attack: of `groups[b]`, by team `team[b]`.

    A joint attack has one team of all k attackers a world. Independent attackers are teams of one, and take the others
    for benign.
    """

    situation: Situation
    world: Int[Tensor, " T"]  # the row of each team's world in the situation
    slots: Int[Tensor, "T m"]  # each attacker's place in `situation.attackers`
    reach: Bool[Tensor, "T m"]  # False for an attacker in none of the groups: its perturbation has no effect
    team: Int[Tensor, " B"]
    groups: Bool[Tensor, "B N"]
    weight: Float[Tensor, " B"]

    @property
    def rows(self) -> Int[Tensor, " B"]:
        """Each view's world: `situation.received[targets.rows]` are its maps."""
        return self.world[self.team]

    @cached_property
    def clean(self) -> Dense:
        """The output with everyone fused and no perturbation; one for each view."""
        clean = self.situation.clean
        return Dense(clean.logits[self.rows], clean.boxes[self.rows])

    @property
    def attackers(self) -> Int[Tensor, "T m"]:
        """Their numbers among the vehicles."""
        return self.situation.attackers[self.world].gather(1, self.slots)

    def of(self, mine: Bool[Tensor, " T"]) -> AttackTargets:
        """The targets of those teams."""
        seen = mine[self.team]
        return replace(
            self,
            world=self.world[mine],
            slots=self.slots[mine],
            reach=self.reach[mine],
            team=(mine.cumsum(0) - 1)[self.team[seen]],
            groups=self.groups[seen],
            weight=self.weight[seen],
        )

    def perceive(self) -> Callable[[Float[Tensor, "T m C H W"]], Dense]:
        """The ego's output in each view, as a differentiable function of the teams' δ."""
        situation, attackers = self.situation, self.attackers
        pose = torch.take_along_dim(situation.ego_T_sender[self.world], attackers[..., None], 1)
        maps = situation.received[self.world], situation.coverage[self.world]
        return attacked_output(situation.ego_detector(self.world), *maps, attackers, pose, self.team, self.groups)


Objective = Callable[[AttackTargets], ViewLoss]
"""What an attack maximises. Called once a frame with the targets, so that it can prepare. What it returns is called at
every step of the ascent with the ego's output in each view, and gives each view's value."""


def attack_loss(targets: AttackTargets, objective: Objective) -> Loss:
    """The expectation of `objective` over each team's views if it adds δ to what it sends, Eq. (1)."""
    perceive, view_loss = targets.perceive(), objective(targets)

    def loss(delta: Float[Tensor, "T m C H W"]) -> Float[Tensor, " T"]:
        value = targets.weight * view_loss(perceive(delta))
        return value.new_zeros(len(delta)).index_add(0, targets.team, value)

    return loss


def collect_targets(
    situation: Situation, target_groups: TargetGroups, due: Bool[Tensor, " E"], *, joint: bool
) -> AttackTargets:
    """The teams that have something to gain: views without an attacker in them are left out.

    Args:
        situation: the current frame.
        target_groups: the groups whose views are attacked.
        due: the worlds that are attacked.
        joint: one team of all attackers a world, or teams of one.

    Returns:
        The targets.

    Raises:
        ValueError: target groups of the wrong shape, type or sign.
    """
    groups, weights = _checked(target_groups(situation), situation)
    groups = groups & situation.present[:, None]
    inside = torch.take_along_dim(groups, situation.attackers[:, None], 2)  # [E, S, k]
    inside = inside & (weights > 0)[..., None] & due[:, None, None]
    if joint:
        world = inside.any((1, 2)).nonzero().flatten()
        slots = torch.arange(inside.shape[2], device=world.device).expand(len(world), -1)
    else:
        world, slot = inside.any(1).nonzero().unbind(1)
        slots = slot[:, None]
    present = torch.take_along_dim(inside[world], slots[:, None], 2)  # [T, S, m]
    team, which = present.any(2).nonzero().unbind(1)
    return AttackTargets(
        situation=situation,
        world=world,
        slots=slots,
        reach=present.any(1),
        team=team,
        groups=groups[world[team], which],
        weight=weights[world[team], which],
    )


def everyone(situation: Situation) -> GroupDistribution:
    """All vehicles that are present, Eq. (1): for attackers that know of no defence."""
    return situation.present[:, None], situation.coverage.new_ones(len(situation.fused), 1)


def fused(situation: Situation) -> GroupDistribution:
    """The group that the ego is expected to fuse: excluded attackers have no effect, and pause."""
    return situation.fused[:, None], situation.coverage.new_ones(len(situation.fused), 1)


TARGET_GROUPS: dict[str, TargetGroups] = {"everyone": everyone, "fused": fused}


def make_target_groups(target_groups: str | TargetGroups) -> TargetGroups:
    """Target groups by name, or the function itself.

    Raises:
        ValueError: an unknown name.
    """
    if not isinstance(target_groups, str):
        return target_groups
    if target_groups not in TARGET_GROUPS:
        raise ValueError(
            f"target_groups must be one of {', '.join(TARGET_GROUPS)}, or a function of yours; got {target_groups!r}"
        )
    return TARGET_GROUPS[target_groups]


def _checked(distribution: tuple[Tensor, Tensor], situation: Situation) -> GroupDistribution:
    groups, weights = distribution
    worlds, maps = situation.fused.shape
    shapes = tuple(groups.shape), tuple(weights.shape)
    if groups.dim() != 3 or shapes != ((worlds, groups.shape[1], maps), (worlds, groups.shape[1])):
        raise ValueError(
            f"target_groups gives groups [E, S, N] and weights [E, S] with E = {worlds} and N = {maps}; got {shapes}"
        )
    if groups.dtype != torch.bool or not bool((weights >= 0).all()):
        raise ValueError(f"target_groups gives boolean groups and weights >= 0; got {groups.dtype} and {weights}")
    return groups, weights
