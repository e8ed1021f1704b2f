"""Bayesian adaptive group testing: a posterior over sets of attackers chooses the verifications of a frame."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from jaxtyping import Bool

from defenders.bayes.acquisition import Candidate, best_collaborators, best_query, best_reference
from defenders.bayes.fleet import open_fleet
from defenders.bayes.histograms import open_likelihood
from defenders.bayes.information import HypothesisSample, Reference, sample_hypotheses
from defenders.bayes.likelihood import Likelihood
from defenders.bayes.particles import Particles
from defenders.bayes.posterior import ONSET_PROB, PERSISTENCE_PROB, Posterior
from defenders.protocol import Defender, Frame, Inspection, Query, Verdict, View

Members = Bool[np.ndarray, " n"]
RENEW_MARGIN = 0.95  # new references replace the old ones if they are at least this share as good
ALARM_PROB = 0.05  # probability of an attack below which nothing is verified


class Bayes(Defender):
    """Bayesian group testing. No vehicle is trusted by rank: not even the ego. See docs/bayes.md.

    In a frame the full view of all present, which is free, is compared with a reference. Then, up to
    `max_verifications` times, the group with the highest expected information is verified, if that is at least
    `min_gain_bits`. Its view is compared with the most informative reference and with the full view, and the posterior
    is updated before the next group is chosen.

    Fused is the group with the highest expected utility under the posterior. The ego perceives that view anyway, so it
    is compared as well. Flagged are the vehicles that then are attackers with probability `certainty`.

    The references are the views of one earlier frame. Whether they are contaminated is part of the posterior. The
    views of this frame that are probably uncontaminated replace them, unless the old ones are more likely to be, by
    more than `RENEW_MARGIN` and by more than the discrimination that a reference loses with age.
    """

    def __init__(
        self,
        *,
        likelihood: str | Likelihood = "calibrated",
        certainty: float = 0.99,
        switch_prob: float = 1e-3,
        initial_attack_prob: float = 1e-4,
        min_gain_bits: float = 0.02,
        max_verifications: int = 2,
        exact_to: int = 15,
        particles: int = 1024,
    ) -> None:
        """Build the defender.

        Args:
            likelihood: "calibrated" (densities measured with the ego's detector), "perfect" (a binary verifier), the
                path of a calibration file, or a `Likelihood`.
            certainty: Posterior probability at which a vehicle is flagged, and at which a set of attackers is final.
            switch_prob: φ, the probability that the set of attackers changes from one frame with an attack to the next.
            initial_attack_prob: Probability of an attack in the very first frame.
            min_gain_bits: Expected information, in bits, below which no verification is paid for.
            max_verifications: Verifications in a frame, at most.
            exact_to: Vehicles up to which every set has its own probability. Above, particles represent them.
            particles: Number of particles.

        Raises:
            ValueError: If an option is out of range.
        """
        if not 0.5 < certainty < 1:
            raise ValueError(f"certainty is a probability above 0.5 and below 1, got {certainty}")
        for name, value in (("switch_prob", switch_prob), ("initial_attack_prob", initial_attack_prob)):
            if not 0 < value < 0.5:
                raise ValueError(f"{name} is a small probability, above 0 and below 0.5, got {value}")
        if min_gain_bits < 0 or max_verifications < 1 or particles < 2 or not 1 <= exact_to <= 20:
            raise ValueError(
                "min_gain_bits must be at least 0, max_verifications at least 1, particles at least 2 and exact_to in "
                f"1..20; got {min_gain_bits}, {max_verifications}, {particles} and {exact_to}"
            )
        self.named, self.likelihood = likelihood, open_likelihood(likelihood)
        self.certainty, self.switch_prob, self.initial_attack_prob = certainty, switch_prob, initial_attack_prob
        self.min_gain_bits, self.max_verifications, self.max_queries = (
            min_gain_bits,
            max_verifications,
            max_verifications + 1,
        )
        self.exact_to, self.particles = exact_to, particles
        self.prepared = 0  # vehicles that there are tables for

    def configure(self, *, fusion: str) -> None:
        self.likelihood, self.prepared = open_likelihood(self.named, fusion), 0

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        self.n, self.rng = n_vehicles, rng
        if n_vehicles != self.prepared:
            self.fleet, self.prepared = open_fleet(self.likelihood, n_vehicles, n_vehicles <= self.exact_to), n_vehicles
        modes = self.likelihood.modes
        self.posterior = (
            Posterior(n_vehicles, switch_prob=self.switch_prob, modes=modes)
            if n_vehicles <= self.exact_to
            else Particles(n_vehicles, switch_prob=self.switch_prob, size=self.particles, rng=rng, modes=modes)
        )
        self.references: dict[frozenset[int], View] = {}
        self.age = 0  # of the references, frames
        self.attack_probs = np.full(modes, self.initial_attack_prob / modes)  # in the coming frame, by mode

    def inspect(self, frame: Frame) -> Inspection:
        here = self.fleet.members(frame.present)
        views: dict[frozenset[int], View] = {frame.present: frame.seen}
        self.posterior.predict(self.attack_probs)
        self.age += 1
        self._learn(frame, frame.present, frame.seen)
        for _ in range(self.max_verifications):
            if (best := self._next_query(frame.present, views)) is None:
                break
            group = numbers(best.group)
            (views[group],) = yield Query([group])
            self._compare(frame, group, views[group], best.reference)
        flagged = self.posterior.attacker_probability() >= self.certainty
        fused = best_collaborators(self.posterior, self.fleet.utility, flagged, here, self.rng)
        collaborators = numbers(fused)
        if collaborators not in views:
            (views[collaborators],) = yield Query([collaborators], verification=False)  # the output of this frame
            self._learn(frame, collaborators, views[collaborators], frame.present)
        suspects = numbers(self.posterior.attacker_probability() >= self.certainty) - collaborators
        verdict = Verdict(collaborators, suspects, self.posterior.likeliest() >= self.certainty)
        self._end(views)
        return verdict

    def belief(self) -> np.ndarray:
        return np.clip(self.posterior.attacker_probability(), 0, 1)

    def _hypotheses(self) -> HypothesisSample:
        return sample_hypotheses(self.posterior, self.rng, 512)

    def _sources(self, present: frozenset[int] | None = None) -> list[Reference]:
        return [self.fleet.reference(group, self.age, present) for group in self.references]

    def _next_query(self, present: frozenset[int], views: dict[frozenset[int], View]) -> Candidate | None:
        """The group to verify next; None where none is informative enough or an attack is improbable."""
        unseen = 2 ** len(present) - 1 - len(views)
        if not self.references or not unseen or self.posterior.attack_probs().sum() < ALARM_PROB:
            return None
        seen, here = self._all_members(views), self.fleet.members(present)
        best = best_query(self._sources(present), self._hypotheses(), here, seen, self.rng)
        return best if best.gain >= self.min_gain_bits else None

    def _learn(self, frame: Frame, group: frozenset[int], view: View, present: frozenset[int] | None = None) -> None:
        """Compare a view with its most informative reference, and with the full view where that is another."""
        if self.references:
            members = self.fleet.members(group)
            self._compare(frame, group, view, best_reference(members, self._sources(present), self._hypotheses()))

    def _compare(self, frame: Frame, group: frozenset[int], view: View, reference: Reference) -> None:
        members = self.fleet.members(group)
        found = self.likelihood.bin(frame.similarity(view, self.references[numbers(reference.group)]))
        self.posterior.update(reference.evidence(members, found))
        if reference.full_view is not None:
            found = self.likelihood.bin(frame.similarity(view, frame.seen), full_view=True)
            self.posterior.update(reference.full_view_evidence(members, found))

    def _all_members(self, groups: Iterable[frozenset[int]]) -> Bool[np.ndarray, "X n"]:
        return np.array([self.fleet.members(group) for group in groups], dtype=bool).reshape(-1, self.n)

    def _end(self, views: dict[frozenset[int], View]) -> None:
        """Keep the references, or replace them by views that are probably uncontaminated."""
        now = self.posterior.uncontaminated_probability(self._all_members(views), now=True)
        then = self.posterior.uncontaminated_probability(self._all_members(self.references), now=False)
        best, old, discrimination = float(now.max()), float(then.max(initial=0)), self.fleet.discrimination
        renew = best * discrimination(1) >= RENEW_MARGIN * old * discrimination(self.age + 1)
        start = ONSET_PROB / self.likelihood.modes
        self.attack_probs = start + (PERSISTENCE_PROB[: self.likelihood.modes] - start) * self.posterior.attack_probs()
        self.posterior.advance(renew)
        if renew:
            self.references = {group: views[group] for group, p in zip(views, now, strict=True) if p >= best / 2}
            self.age = 0


def numbers(members: Members) -> frozenset[int]:
    """Numbers of the members."""
    return frozenset(members.nonzero()[0].tolist())
