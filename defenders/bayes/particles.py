"""The posterior over sets of liars for fleets too large to list all sets: particles that move.

The recursion of `posterior` is pointwise in the set, so the density at any set can be computed by replaying the
evidence. Particles are sets drawn from the prior and weighted by the evidence; where few carry the weight they are
drawn anew, and after every frame with lies each tries to change by one vehicle, or to exchange one for another, and is
accepted as Metropolis and Hastings say, which leaves the posterior as it is.

Frames in which nobody lies say nothing about who would; they are not replayed. After `MEMORY` frames with lies the
evidence is summed up as one probability for each vehicle, independent of each other, and the replay starts from there.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from defenders.bayes.posterior import Chances, Density, Evidence, Posterior, Sets, ended, predicted, prior, settled

MEMORY = 32  # frames that are replayed
MOVES, MORE_MOVES = 3, 12  # tried by every particle after a frame with lies: as a rule, and after a redraw
IDLE = 1e-3  # probability of lies below which a frame counts as a pause
DOUBT = 1e-4  # at least so likely is either, a liar or not, in a summary


@dataclass(eq=False)
class Chapter:
    """The evidence of one frame, its probability, and whether the frame's views became the references."""

    evidence: list[Evidence] = field(default_factory=list)
    total: float = 1.0
    lying: Chances = field(default_factory=lambda: np.zeros(1))
    renew: bool = True
    pause: bool = False


@dataclass(frozen=True, eq=False)
class Summary:
    """All evidence before the first chapter: each vehicle's probability to lie, and that of each b."""

    guilt: Float[np.ndarray, " n"]
    then: Float[np.ndarray, " A"]


class Particles(Posterior):
    """A sample of sets; `scale` [S] is a particle's weight over the density at its set."""

    def __init__(self, n: int, *, turn: float, size: int, rng: np.random.Generator, manners: int = 1) -> None:
        self.rng = rng
        self.history: list[Chapter] = []
        self.chapter = Chapter()
        self.summary: Summary | None = None
        self._begin(drawn(n, size, rng), turn, manners)
        self._weigh(np.full(size, 1 / size))

    def predict(self, lying: Chances) -> None:
        self.chapter, self.before = Chapter(lying=lying), self.density
        super().predict(lying)

    def update(self, evidence: Evidence) -> None:
        self.chapter.evidence.append(evidence)
        super().update(evidence)

    def _normalise(self) -> None:
        total = float(self.mass.sum())
        self.joint /= total
        self.chapter.total *= total

    def advance(self, renew: bool) -> None:
        self.chapter.renew, self.chapter.pause = renew, float(self.mass[:, :, 1:].sum()) < IDLE
        if self.chapter.pause:
            self.joint = settled(resting(self.before, renew))
        else:
            super().advance(renew)
        if not (self.chapter.pause and self.history and self.history[-1].pause):
            self.history.append(self.chapter)
        if not self.chapter.pause:
            self._rejuvenate()
        if len(self.history) > MEMORY:
            self._sum_up()

    def replay(self, sets: Sets) -> Density:
        """The density p(L, b) at any sets."""
        birth = prior(sets)
        density = self._start(sets, birth)
        for chapter in self.history:
            if chapter.pause:
                density = resting(density, chapter.renew)
                continue
            joint = predicted(density, sets, birth, self.turn, chapter.lying) / chapter.total
            for evidence in chapter.evidence:
                joint *= evidence.likelihood(sets)
            density = ended(joint, chapter.renew)
        return density

    def _start(self, sets: Sets, birth: Float[np.ndarray, " S"]) -> Density:
        if self.summary is None:
            honest = np.eye(self.joint.shape[1])[0]
            return birth[:, None] * honest
        each = np.where(sets, self.summary.guilt, 1 - self.summary.guilt).prod(1) * (birth > 0)
        return each[:, None] * self.summary.then

    def _weigh(self, weight: Float[np.ndarray, " S"]) -> None:
        self.scale = weight / self.density.sum(1)

    def likeliest(self) -> float:
        """Probability of the likeliest set, all particles at it together."""
        _, which = np.unique(self.sets, axis=0, return_inverse=True)
        return float(np.bincount(which.reshape(-1), self.mass.sum((1, 2))).max())

    def _rejuvenate(self) -> None:
        """Redraw where fewer than half of the particles count, then move."""
        current = self.density
        weight = current.sum(1) * self.scale
        weight /= weight.sum()
        redraw = 1 / (weight**2).sum() < len(weight) / 2
        if redraw:
            steps = np.cumsum(weight)
            chosen = np.searchsorted(steps, (np.arange(len(weight)) + self.rng.random()) / len(weight))
            chosen = chosen.clip(max=len(weight) - 1)
            self.sets, current = self.sets[chosen], current[chosen]
            weight = np.full(len(weight), 1 / len(weight))
        for _ in range(MORE_MOVES if redraw else MOVES):
            proposed = moved(self.sets, self.rng)
            density = self.replay(proposed)
            taken = self.rng.random(len(weight)) * current.sum(1) < density.sum(1)
            self.sets = np.where(taken[:, None], proposed, self.sets)
            current = np.where(taken[:, None], density, current)
        self.prior, self.joint = prior(self.sets), settled(current)
        self._weigh(weight)

    def _sum_up(self) -> None:
        density = self.density * self.scale[:, None]
        weight, then = density.sum(1), density.sum(0) / density.sum()
        self.summary = Summary(np.clip(weight @ self.sets / weight.sum(), DOUBT, 1 - DOUBT), then)
        self.history.clear()
        self.joint = settled(self.replay(self.sets))
        self._weigh(weight / weight.sum())


def drawn(n: int, size: int, rng: np.random.Generator) -> Sets:
    """Sets from the prior, as many of each number of liars as can be."""
    numbers = np.floor((np.arange(size) + rng.random()) * n / size).astype(int).clip(max=n - 1)
    ranks = rng.random((size, n)).argsort(1).argsort(1)
    return ranks < numbers[:, None]


def moved(sets: Sets, rng: np.random.Generator) -> Sets:
    """Each set with one vehicle changed or, as often, with two: if they differ they are exchanged. Symmetric."""
    rows, n = np.arange(len(sets)), sets.shape[1]
    one, two = rng.integers(n, size=len(sets)), rng.integers(n, size=len(sets))
    exchange = (rng.random(len(sets)) < 0.5) & (sets[rows, one] != sets[rows, two])
    result = sets.copy()
    result[rows, one] ^= True
    result[rows[exchange], two[exchange]] ^= True
    return result


def resting(density: Density, renew: bool) -> Density:
    """p(L, b) after a frame in which surely nobody lied; if its views became the references, those are honest."""
    if not renew:
        return density
    rested = np.zeros_like(density)
    rested[:, 0] = density.sum(1)
    return rested
