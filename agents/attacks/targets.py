"""What liars work on: teams that optimise together, and the views of the ego in which their lies count."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from cp_env.detector.model.decoder import Dense
from cp_env.perturbation.objective import lies
from cp_env.world.situation import Situation

Crowd = tuple[Bool[Tensor, "E S N"], Float[Tensor, "E S"]]
Audience = Callable[[Situation], Crowd]
"""From a situation to S groups for each world whose views are attacked, and the weight of each in the expectation.

A weight of 0 leaves a group out, so worlds may have different numbers of groups. The weights need not sum to 1.
"""

Score = Callable[[Dense], Float[Tensor, " B"]]
Loss = Callable[[Float[Tensor, "T m C H W"]], Float[Tensor, " T"]]


@dataclass(frozen=True, eq=False)
class Views:
    """T teams of m liars each, and B views that they attack: of `groups[b]`, by team `team[b]`.

    A joint attack has one team of all k liars a world; independent liars are teams of one, and think the others honest.
    """

    situation: Situation
    world: Int[Tensor, " T"]  # the row of each team's world in the situation
    slots: Int[Tensor, "T m"]  # each liar's place in `situation.attackers`
    reach: Bool[Tensor, "T m"]  # False for a liar who is in none of the groups: its lies have no effect
    team: Int[Tensor, " B"]
    groups: Bool[Tensor, "B N"]
    weight: Float[Tensor, " B"]

    @property
    def rows(self) -> Int[Tensor, " B"]:
        """Each view's world: `situation.received[views.rows]` are its maps."""
        return self.world[self.team]

    @cached_property
    def clean(self) -> Dense:
        """What the ego would have seen, everyone fused and nobody lying; one for each view."""
        clean = self.situation.clean
        return Dense(clean.logits[self.rows], clean.boxes[self.rows])

    @property
    def liars(self) -> Int[Tensor, "T m"]:
        """Their numbers among the vehicles."""
        return self.situation.attackers[self.world].gather(1, self.slots)

    def of(self, mine: Bool[Tensor, " T"]) -> Views:
        """Those of the teams, and what they attack."""
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
        """What the ego sees in each view, as a function of the teams' δ; differentiable."""
        situation, liars = self.situation, self.liars
        pose = torch.take_along_dim(situation.ego_T_sender[self.world], liars[..., None], 1)
        maps = situation.received[self.world], situation.coverage[self.world]
        return lies(situation.eyes(self.world), *maps, liars, pose, self.team, self.groups)


Goal = Callable[[Views], Score]
"""What liars maximise. Called once a frame with the views, so that it can prepare; what it returns is called at every
step of the ascent with what the ego perceives in each view, and gives each view's value."""


def attack_loss(views: Views, goal: Goal) -> Loss:
    """The expectation of `goal` over each team's views if it adds δ to what it sends, Eq. (1)."""
    perceive, score = views.perceive(), goal(views)

    def loss(delta: Float[Tensor, "T m C H W"]) -> Float[Tensor, " T"]:
        value = views.weight * score(perceive(delta))
        return value.new_zeros(len(delta)).index_add(0, views.team, value)

    return loss


def survey(situation: Situation, audience: Audience, due: Bool[Tensor, " E"], *, joint: bool) -> Views:
    """The teams that have something to gain, in the worlds that are `due`: views without a liar in them are left out.

    Raises ValueError for an audience of the wrong shape, type or sign.
    """
    groups, weights = _checked(audience(situation), situation)
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
    return Views(
        situation=situation,
        world=world,
        slots=slots,
        reach=present.any(1),
        team=team,
        groups=groups[world[team], which],
        weight=weights[world[team], which],
    )


def everyone(situation: Situation) -> Crowd:
    """All present, who are fused before anyone is suspected: Eq. (1), by liars that know of no defence."""
    return situation.present[:, None], situation.received.new_ones(len(situation.fused), 1)


def fused(situation: Situation) -> Crowd:
    """Those the ego is expected to fuse: the excluded have no effect, know it, and pause."""
    return situation.fused[:, None], situation.received.new_ones(len(situation.fused), 1)


AUDIENCES: dict[str, Audience] = {"everyone": everyone, "fused": fused}


def make_audience(audience: str | Audience) -> Audience:
    """The audience of that name, or the function itself."""
    if not isinstance(audience, str):
        return audience
    if audience not in AUDIENCES:
        raise ValueError(f"audience must be one of {', '.join(AUDIENCES)}, or a function of yours; got {audience!r}")
    return AUDIENCES[audience]


def _checked(crowd: tuple[Tensor, Tensor], situation: Situation) -> Crowd:
    groups, weights = crowd
    worlds, maps = situation.fused.shape
    shapes = tuple(groups.shape), tuple(weights.shape)
    if groups.dim() != 3 or shapes != ((worlds, groups.shape[1], maps), (worlds, groups.shape[1])):
        raise ValueError(
            f"an audience gives groups [E, S, N] and weights [E, S] with E = {worlds} and N = {maps}; got {shapes}"
        )
    if groups.dtype != torch.bool or not bool((weights >= 0).all()):
        raise ValueError(f"an audience gives boolean groups and weights >= 0; got {groups.dtype} and {weights}")
    return groups, weights
