"""Bayesian adaptive group testing: a posterior over sets of liars, and the two looks a frame that tell most."""

from __future__ import annotations

from itertools import product

import numpy as np
from jaxtyping import Bool

from defenders.bayes.acquisition import Aside, Look, Outlook, Reference, best_look, best_reference, outlook, safest
from defenders.bayes.histograms import open_likelihood
from defenders.bayes.likelihood import BesideTable, Likelihood
from defenders.bayes.particles import Particles
from defenders.bayes.posterior import STARTS, STAYS, Beside, Comparison, Posterior
from defenders.protocol import Defender, Frame, Inspection, Query, Verdict, View

Members = Bool[np.ndarray, " n"]
PATIENCE = 0.95  # new references as good as the old ones but for this are preferred
ALARM = 0.05  # probability of lies below which no look is thought of


class Bayes(Defender):
    """Trusts nobody by rank: not the ego, not the first frame, not its own last verdict. See docs/bayes.md.

    A frame: the free view of all present is compared with a reference; then, twice, the group whose view is expected
    to tell most is asked for, if that is at least `worthwhile` bits, compared with the reference by which it tells most
    and with the free view, and taken in: the second look knows what the first told. Fused are those whose view is worth
    most under the posterior. The ego perceives that one anyway, so it is compared as well; and accused are those who
    then lie with probability `certainty`.

    The references are the views of one earlier frame, whose honesty is part of the posterior. This frame's views
    that are likely to be honest replace them, unless the old ones are likelier to be, by more than `PATIENCE` and by
    more than what a reference loses with age.
    """

    def __init__(
        self,
        *,
        likelihood: str | Likelihood = "calibrated",
        certainty: float = 0.99,
        turn: float = 1e-3,
        first: float = 1e-4,
        worthwhile: float = 0.02,
        looks: int = 2,
        exact_to: int = 15,
        particles: int = 1024,
    ) -> None:
        """ValueError for knobs out of range.

        likelihood   "calibrated" (shipped, of the ego's fusion), "perfect" (a yes/no world), or a `Likelihood`
        certainty    posterior probability at which a vehicle is accused, and a set of liars settled
        turn         φ, the probability that the set of liars is another from one frame with lies to the next
        first        the probability that liars are at work in the very first frame
        worthwhile   bits that a look must be expected to tell to be paid for
        looks        verifications paid for in a frame at most
        exact_to     vehicles up to which every set has its own probability; above, `particles` stand for all
        """
        if not 0.5 < certainty < 1:
            raise ValueError(f"certainty is a probability above 0.5 and below 1, got {certainty}")
        for name, value in (("turn", turn), ("first", first)):
            if not 0 < value < 0.5:
                raise ValueError(f"{name} is a small probability, above 0 and below 0.5, got {value}")
        if worthwhile < 0 or looks < 1 or particles < 2 or not 1 <= exact_to <= 20:
            raise ValueError(
                "worthwhile must be at least 0, looks at least 1, particles at least 2 and exact_to in 1..20; got "
                f"{worthwhile}, {looks}, {particles} and {exact_to}"
            )
        self.named, self.likelihood = likelihood, open_likelihood(likelihood)
        self.certainty, self.turn, self.first = certainty, turn, first
        self.worthwhile, self.looks, self.max_queries = worthwhile, looks, looks + 1
        self.exact_to, self.particles = exact_to, particles
        self.prepared = 0  # vehicles that there are tables for

    def configure(self, *, fusion: str) -> None:
        self.likelihood, self.prepared = open_likelihood(self.named, fusion), 0

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        self.n, self.rng = n_vehicles, rng
        if n_vehicles != self.prepared:
            self.tables, self.worth = self.likelihood.tables(n_vehicles), worth_table(self.likelihood, n_vehicles)
            self.beside: dict[int, BesideTable] = {}  # by how many are present
            self.prepared = n_vehicles
        manners = self.likelihood.manners
        self.posterior = (
            Posterior(n_vehicles, turn=self.turn, manners=manners)
            if n_vehicles <= self.exact_to
            else Particles(n_vehicles, turn=self.turn, size=self.particles, rng=rng, manners=manners)
        )
        self.references: dict[frozenset[int], View] = {}
        self.age = 0  # of the references, frames
        self.lying = np.full(manners, self.first / manners)  # probability of lies in the coming frame, by manner

    def inspect(self, frame: Frame) -> Inspection:
        here = self._members(frame.present)
        views: dict[frozenset[int], View] = {frame.present: frame.seen}
        self.posterior.predict(self.lying)
        self.age += 1
        self._learn(frame, frame.present, frame.seen)
        aside = Aside(here, self._beside(len(frame.present)))
        for _ in range(self.looks):
            if (look := self._next_look(aside, views)) is None:
                break
            group = numbers(look.group)
            (views[group],) = yield Query([group])
            self._compare(frame, group, views[group], look.reference)
        guilty = self.posterior.guilt() >= self.certainty
        fused = safest(self.posterior, self.worth, guilty, here, self.rng)
        collaborators = numbers(fused)
        if collaborators not in views:
            (views[collaborators],) = yield Query([collaborators], verification=False)  # the output of this frame
            self._learn(frame, collaborators, views[collaborators], aside)
        suspects = numbers(self.posterior.guilt() >= self.certainty) - collaborators
        verdict = Verdict(collaborators, suspects, self.posterior.likeliest() >= self.certainty)
        self._end(views)
        return verdict

    def belief(self) -> np.ndarray:
        return np.clip(self.posterior.guilt(), 0, 1)

    def _outlook(self) -> Outlook:
        return outlook(self.posterior, self.rng, 512)

    def _beside(self, present: int) -> BesideTable:
        if present not in self.beside:
            self.beside[present] = BesideTable(self.likelihood, present)
        return self.beside[present]

    def _sources(self, aside: Aside | None = None) -> list[Reference]:
        table = self.tables[min(self.age, len(self.tables)) - 1]
        return [Reference(self._members(group), table, aside) for group in self.references]

    def _next_look(self, aside: Aside, views: dict[frozenset[int], View]) -> Look | None:
        """The group to pay for, or None where none would tell enough; surely so where nobody lies."""
        unseen = 2 ** int(aside.present.sum()) - 1 - len(views)
        if not self.references or not unseen or self.posterior.lies().sum() < ALARM:
            return None
        seen = np.array([self._members(group) for group in views])
        best = best_look(self._sources(aside), self._outlook(), aside.present, seen, self.rng)
        return best if best.gain >= self.worthwhile else None

    def _learn(self, frame: Frame, group: frozenset[int], view: View, aside: Aside | None = None) -> None:
        """Compare a view with the reference by which it tells most, and with the free view where it is another."""
        if self.references:
            reference = best_reference(self._members(group), self._sources(aside), self._outlook())
            self._compare(frame, group, view, reference)

    def _compare(self, frame: Frame, group: frozenset[int], view: View, reference: Reference) -> None:
        similarity = frame.similarity(view, self.references[numbers(reference.group)])
        found = self.likelihood.bin(similarity)
        self.posterior.update(Comparison(self._members(group), reference.group, reference.table, found))
        if (aside := reference.aside) is not None:
            found = self.likelihood.bin(frame.similarity(view, frame.seen), beside=True)
            self.posterior.update(Beside(self._members(group), aside.present, aside.table, found))

    def _end(self, views: dict[frozenset[int], View]) -> None:
        """Keep the references or renew them: by views that are likely to be honest."""
        clean = {group: self.posterior.clean(self._members(group), now=True) for group in views}
        old = max((self.posterior.clean(self._members(g), now=False) for g in self.references), default=0.0)
        best = max(clean.values())
        renew = best * self.likelihood.power(1) >= PATIENCE * old * self.likelihood.power(self.age + 1)
        start = STARTS / self.likelihood.manners
        self.lying = start + (STAYS[: self.likelihood.manners] - start) * self.posterior.lies()
        self.posterior.advance(renew)
        if renew:
            self.references = {group: view for group, view in views.items() if clean[group] >= best / 2}
            self.age = 0

    def _members(self, group: frozenset[int]) -> Members:
        members = np.zeros(self.n, dtype=bool)
        members[list(group)] = True
        return members


def numbers(members: Members) -> frozenset[int]:
    """Numbers of the vehicles that are members."""
    return frozenset(np.flatnonzero(members).tolist())


def worth_table(likelihood: Likelihood, n: int) -> np.ndarray:
    """`worth[manner, size, liars]` of a view; the last column, -1, is a glitch: no group is better than another."""
    table = np.zeros((likelihood.manners + 1, n + 1, n + 2))
    for manner, size in product(range(likelihood.manners + 1), range(1, n + 1)):
        worth = [likelihood.worth(size, liars, manner) for liars in range(size + 1 if manner else 1)]
        table[manner, size, : len(worth)] = worth
    table[:, 1:, -1] = likelihood.worth(1, 0)
    return table
