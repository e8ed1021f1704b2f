"""A slow twin of `bayes`: likelihoods and expected information read off their definitions, one case at a time.

It knows the densities themselves and no table of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from defenders.bayes.information import HypothesisSample, Reference
from defenders.bayes.likelihood import OUTLIER_MIX, Likelihood
from defenders.bayes.posterior import Evidence, Known, every_set

Group = frozenset[int]


def density(
    likelihood: Likelihood, group: Group, reference: Group, age: int, attackers: Group, b: int, a: int
) -> np.ndarray:
    """Density of the similarity of a group's view to a reference under the hypothesis (L, b, a)."""
    if not attackers and (a or b):
        one, other = (min(len(members), likelihood.most) for members in (group, reference))
        return likelihood.outlier(one, other, a or b)
    now, then = len(group & attackers) if a else 0, len(reference & attackers) if b else 0
    if now and then:
        return likelihood.both_contaminated(len(group), len(reference), a, b)
    if now:
        return likelihood.one_contaminated(len(group), now, len(reference), a)
    if then:
        return likelihood.one_contaminated(len(reference), then, len(group), b)
    return likelihood.uncontaminated(len(group), len(reference), len(group & reference), age)


def full_view_density(likelihood: Likelihood, group: Group, present: Group, attackers: Group, a: int) -> np.ndarray:
    """Density of the similarity of a group's view to the full view of its frame under the hypothesis (L, b, a)."""
    size, everyone = len(group), len(present)
    if attackers or not a:
        inside, total = (len(group & attackers), len(present & attackers)) if a else (0, 0)
        return likelihood.full_view(size, inside, everyone, total, max(a, 1))
    kinds = [
        likelihood.full_view(size, inside, everyone, total, a)
        for total in range(everyone + 1)
        for inside in range(size + 1)
        if 0 <= total - inside <= everyone - size
    ]
    return (1 - OUTLIER_MIX) * likelihood.full_view(size, 0, everyone, 0, a) + OUTLIER_MIX * np.mean(kinds, axis=0)


@dataclass(frozen=True, eq=False, kw_only=True)
class SlowReference(Reference):
    """A reference of age `age` that works everything out anew, hypothesis by hypothesis."""

    likelihood: Likelihood
    age: int

    def information_gain(self, groups: np.ndarray, hypotheses: HypothesisSample) -> np.ndarray:
        """Σ p(h) p(y | h) log2(p(y | h) / p(y)); y is one bin, or a pair of bins."""
        gains = []
        for group in groups:
            weighted = [
                (mass, self._given(members(group), members(hypotheses.sets[h]), b, a))
                for (h, b, a), mass in np.ndenumerate(hypotheses.mass)
                if mass > 0
            ]
            mixture = sum(mass * given for mass, given in weighted)
            assert isinstance(mixture, np.ndarray)
            gains.append(
                sum(
                    mass * p * math.log2(p / total)
                    for mass, given in weighted
                    for p, total in zip(given.tolist(), mixture.tolist(), strict=True)
                    if p
                )
            )
        return np.array(gains, dtype=float)

    def evidence(self, group: np.ndarray, found: int) -> Evidence:
        """The likelihood of every hypothesis by itself."""
        return self._known(lambda attackers, b, a: self._density(members(group), attackers, b, a)[found])

    def full_view_evidence(self, group: np.ndarray, found: int) -> Evidence:
        """The likelihood of every hypothesis by itself."""
        return self._known(lambda attackers, _, a: self._full_view_density(members(group), attackers, a)[found])

    def _known(self, of: Callable[[Group, int, int], float]) -> Known:
        sets, modes = every_set(len(self.group)), range(self.likelihood.modes + 1)
        return Known(np.array([[[of(members(one), b, a) for a in modes] for b in modes] for one in sets]))

    def _given(self, group: Group, attackers: Group, b: int, a: int) -> np.ndarray:
        given = self._density(group, attackers, b, a)
        if self.full_view is None:
            return given
        return np.outer(given, self._full_view_density(group, attackers, a)).reshape(-1)

    def _density(self, group: Group, attackers: Group, b: int, a: int) -> np.ndarray:
        return density(self.likelihood, group, members(self.group), self.age, attackers, b, a)

    def _full_view_density(self, group: Group, attackers: Group, a: int) -> np.ndarray:
        assert self.full_view is not None
        return full_view_density(self.likelihood, group, members(self.full_view.present), attackers, a)


def members(group: np.ndarray) -> Group:
    """Numbers of the members."""
    return frozenset(np.flatnonzero(group).tolist())
