"""The posterior over sets of attackers for fleets with too many sets to list: a particle filter with moves.

The recursion of `posterior` is pointwise in the set, so the density at any set follows by replaying the evidence.
Particles are sets drawn from the prior and weighted by the evidence. Where few carry the weight they are resampled.
After every frame with an attack each particle proposes to change one vehicle, or to exchange one for another, and
accepts by the rule of Metropolis and Hastings, which leaves the posterior as it is.

Frames without an attack carry no information about the attackers and are not replayed. After `MEMORY` frames with
attacks the evidence is summarised as one independent probability for each vehicle, and the replay starts from there.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from defenders.bayes.posterior import (
    Density,
    Evidence,
    Joint,
    ModeProbs,
    Posterior,
    Sets,
    ended,
    predicted,
    prior,
    settled,
)

MEMORY = 32  # frames that are replayed
MOVES, MORE_MOVES = 3, 12  # proposed by every particle after a frame with an attack: as a rule, after resampling
IDLE = 1e-3  # probability of an attack below which a frame counts as a pause
DOUBT = 1e-4  # least probability of either case, attacker or benign, in a summary


@dataclass(eq=False)
class FrameEvidence:
    """The evidence of one frame, its probability, and whether the frame's views became the references."""

    evidence: list[Evidence] = field(default_factory=list)
    total: float = 1.0
    attack_probs: ModeProbs = field(default_factory=lambda: np.zeros(1))
    renew: bool = True
    pause: bool = False


@dataclass(frozen=True, eq=False)
class MarginalSummary:
    """All evidence before the replayed frames: the probability of each vehicle to be an attacker, and of each b."""

    attacker_probability: Float[np.ndarray, " n"]
    then: Float[np.ndarray, " A"]


class Particles(Posterior):
    """A sample of sets; `scale` [S] is a particle's weight over the density at its set."""

    def __init__(self, n: int, *, switch_prob: float, size: int, rng: np.random.Generator, modes: int = 1) -> None:
        self.rng = rng
        self.history: list[FrameEvidence] = []
        self.frame = FrameEvidence()
        self.summary: MarginalSummary | None = None
        sets = drawn(n, size, rng)
        self._begin(sets, prior(sets), switch_prob, modes)
        self._weigh(np.full(size, 1 / size))

    @property
    def mass(self) -> Joint:
        return self.joint * self.scale[:, None, None]

    def predict(self, attack_probs: ModeProbs) -> None:
        self.frame, self.before = FrameEvidence(attack_probs=attack_probs), self.density
        super().predict(attack_probs)

    def update(self, evidence: Evidence) -> None:
        self.frame.evidence.append(evidence)
        super().update(evidence)

    def _normalise(self) -> None:
        total = float(self.mass.sum())
        self.joint = self.joint / total
        self.frame.total *= total

    def advance(self, renew: bool) -> None:
        self.frame.renew, self.frame.pause = renew, float(self.mass[:, :, 1:].sum()) < IDLE
        if self.frame.pause:
            self.joint = settled(resting(self.before, renew))
        else:
            super().advance(renew)
        if not (self.frame.pause and self.history and self.history[-1].pause):
            self.history.append(self.frame)
        if not self.frame.pause:
            self._rejuvenate()
        if len(self.history) > MEMORY:
            self._sum_up()

    def replay(self, sets: Sets) -> Density:
        """The density p(L, b) at any sets."""
        birth = prior(sets)
        density = self._start(sets, birth)
        for frame in self.history:
            if frame.pause:
                density = resting(density, frame.renew)
                continue
            joint = predicted(density, sets, birth, self.switch_prob, frame.attack_probs) / frame.total
            for evidence in frame.evidence:
                joint *= evidence.likelihood(sets)
            density = ended(joint, frame.renew)
        return density

    def _start(self, sets: Sets, birth: Float[np.ndarray, " S"]) -> Density:
        if self.summary is None:
            none = np.eye(self.joint.shape[1])[0]
            return birth[:, None] * none
        each = np.where(sets, self.summary.attacker_probability, 1 - self.summary.attacker_probability).prod(1) * (
            birth > 0
        )
        return each[:, None] * self.summary.then

    def _weigh(self, weight: Float[np.ndarray, " S"]) -> None:
        self.scale = weight / self.density.sum(1)

    def likeliest(self) -> float:
        """Probability of the likeliest set, all particles at it together."""
        _, which = np.unique(self.sets, axis=0, return_inverse=True)
        return float(np.bincount(which.reshape(-1), self.mass.sum((1, 2))).max())

    def _rejuvenate(self) -> None:
        """Resample where fewer than half of the particles count, then move."""
        current = self.density
        weight = current.sum(1) * self.scale
        weight /= weight.sum()
        resample = 1 / (weight**2).sum() < len(weight) / 2
        if resample:
            steps = np.cumsum(weight)
            chosen = np.searchsorted(steps, (np.arange(len(weight)) + self.rng.random()) / len(weight))
            chosen = chosen.clip(max=len(weight) - 1)
            self.sets, current = self.sets[chosen], current[chosen]
            weight = np.full(len(weight), 1 / len(weight))
        for _ in range(MORE_MOVES if resample else MOVES):
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
        self.summary = MarginalSummary(np.clip(weight @ self.sets / weight.sum(), DOUBT, 1 - DOUBT), then)
        self.history.clear()
        self.joint = settled(self.replay(self.sets))
        self._weigh(weight / weight.sum())


def drawn(n: int, size: int, rng: np.random.Generator) -> Sets:
    """Sets from the prior, as many of each number of attackers as can be."""
    numbers = np.floor((np.arange(size) + rng.random()) * n / size).astype(int).clip(max=n - 1)
    ranks = rng.random((size, n)).argsort(1).argsort(1)
    return ranks < numbers[:, None]


def moved(sets: Sets, rng: np.random.Generator) -> Sets:
    """Symmetric proposals: each set with one vehicle changed or, as often, with two different ones exchanged."""
    rows, n = np.arange(len(sets)), sets.shape[1]
    one, two = rng.integers(n, size=len(sets)), rng.integers(n, size=len(sets))
    exchange = (rng.random(len(sets)) < 0.5) & (sets[rows, one] != sets[rows, two])
    result = sets.copy()
    result[rows, one] ^= True
    result[rows[exchange], two[exchange]] ^= True
    return result


def resting(density: Density, renew: bool) -> Density:
    """p(L, b) after a frame surely without an attack. If its views became the references, those are uncontaminated."""
    if not renew:
        return density
    rested = np.zeros_like(density)
    rested[:, 0] = density.sum(1)
    return rested
