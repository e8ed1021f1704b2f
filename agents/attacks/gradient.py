"""The white-box attacker: one frame of it is whom, what, where, how much, and then a search. All are arguments."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Bool, Float, Shaped
from torch import Tensor

from agents.attacks.constraint import Domain, make_ball
from agents.attacks.objectives.untargeted import make_objective
from agents.attacks.pgd import Search, Steepest, better
from agents.attacks.schedule import Allowance, Schedule, always, make_schedule, whole
from agents.attacks.targets import Audience, Goal, Views, attack_loss, make_audience, survey
from agents.protocol import Streams, streams
from cp_env.world.situation import Situation

TOGETHER = {"cpu": 8}
"""Worlds whose liars search in one batch, by kind of device: more maps than caches hold are slower, not faster."""

Cells = Callable[[Situation], Shaped[Tensor, "E k H W"]]
"""The cells of each liar's own map (its grid frame) that it may touch: True or 1, else False or 0."""


@dataclass
class Ascent:
    """Liars that search for the δ that maximises an objective of what the ego will see, through warp, fusion, decoder.

    search        how: `Steepest` (PGD, BIM, MI-FGSM) or `CarliniWagner`
    random_start  from a random point of the ball, or from zero
    restarts      so many starts, the best end is kept; beyond the first, zero is among them and the others are random,
                  so that more of them are never weaker than PGD or BIM
    objective     what: `both`, `hide`, `spoof`, `remove@…`, `plant@…`, or any `Goal`
    audience      whose view: of "everyone" fused, Eq. (1), by liars that know of no defence and never pause; of those
                  the ego "fused" last, by liars that do: the excluded have no effect and pause; or any `Audience`
    schedule      when; in grace frames all pause
    allowance     how much of Δ, as a share, frame by frame
    where         on which cells of the liars' maps; all by default
    joint         all liars of a world search together, or each for itself as if the others were honest
    """

    search: Search = field(default_factory=Steepest)
    random_start: bool = True
    restarts: int = 1
    objective: str | Goal = "both"
    audience: str | Audience = "everyone"
    schedule: str | Schedule = always
    allowance: Allowance = whole
    where: Cells | None = None
    joint: bool = True
    _streams: list[np.random.Generator] = field(default_factory=list, init=False, repr=False)

    def __post_init__(self) -> None:
        if self.restarts < 1:
            raise ValueError(f"restarts counts the starts and must be at least 1, got {self.restarts}")
        self._goal, self._audience = make_objective(self.objective), make_audience(self.audience)
        self._schedule = make_schedule(self.schedule)

    def reset(self, n_worlds: int, rng: Streams) -> None:
        self._streams = streams(n_worlds, rng)

    def act(self, situation: Situation) -> Float[Tensor, "E k C H W"]:
        """See `Attacker.act`. Raises ValueError for an audience, an allowance or cells that cannot be used."""
        delta = silence(situation)
        views = survey(situation, self._audience, due(situation, self._schedule), joint=self.joint)
        if len(views.world):
            domain, worlds = self._domain(views), views.world.unique()
            for together in worlds.split(TOGETHER.get(delta.device.type, len(worlds))):
                mine = torch.isin(views.world, together)
                part = views.of(mine)
                delta[part.world[:, None], part.slots] = self._found(part, domain.of(mine), delta)
        return delta

    def _found(self, views: Views, domain: Domain, zero: Float[Tensor, "E k C H W"]) -> Float[Tensor, "T m C H W"]:
        """The best δ of all restarts."""
        loss = attack_loss(views, self._goal)
        from_zero = int(self.random_start)  # the number of the start that is no random one
        starts = (self._start(views, zero, random=i != from_zero) for i in range(self.restarts))
        best, best_value = self.search(loss, next(starts), domain)
        for start in starts:
            best, best_value = better(best, best_value, *self.search(loss, start, domain))
        return best

    def _domain(self, views: Views) -> Domain:
        """Where the teams' δ may lie."""
        situation = views.situation
        share = np.asarray(self.allowance(situation.frame), dtype=np.float32)
        if share.shape != situation.frame.shape or not ((share >= 0) & (share <= 1)).all():
            raise ValueError(f"an allowance is a share of the budget, 0 to 1, for each world; got {share.tolist()}")
        cells = None
        if self.where is not None:
            mask, shape = self.where(situation), (*situation.attackers.shape, *situation.received.shape[-2:])
            if tuple(mask.shape) != shape:
                raise ValueError(f"where must give cells of shape [E, k, H, W] = {shape}, not {tuple(mask.shape)}")
            cells = (mask[views.world[:, None], views.slots] > 0).to(situation.received)[:, :, None]
        if (share == 1).all():
            return Domain(situation.norm, situation.budget, cells=cells)
        shares = torch.from_numpy(share).to(situation.received)[views.world]
        return Domain(situation.norm, situation.budget, shares[:, None, None, None, None], cells)

    def _start(self, views: Views, zero: Float[Tensor, "E k C H W"], *, random: bool) -> Float[Tensor, "T m C H W"]:
        """Zero for liars without effect, so that they stay there."""
        if not random:
            return zero[views.world[:, None], views.slots]
        ball, (k, c, h, w), start = make_ball(views.situation.norm), zero.shape[1:], torch.zeros_like(zero)
        for e in views.world.unique().tolist():
            start[e] = ball.random((k, c, h, w), views.situation.budget, self._streams[e])
        return start[views.world[:, None], views.slots] * views.reach[..., None, None, None]


def silence(situation: Situation) -> Float[Tensor, "E k C H W"]:
    """No perturbation."""
    worlds, k = situation.attackers.shape
    return situation.received.new_zeros((worlds, k, *situation.received.shape[2:]))


def due(situation: Situation, schedule: Schedule) -> Bool[Tensor, " E"]:
    """The worlds in which this is a frame for lying."""
    return situation.active & torch.from_numpy(schedule(situation.frame)).to(situation.active.device)
