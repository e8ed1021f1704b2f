"""The posterior over sets of attackers and the choice of groups: laws, and slow twins that sum over every case."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import combinations, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from defenders.bayes.likelihood import Likelihood, Verifier
from defenders.bayes.posterior import ONSET_PROB, OUTLIER_PRIOR, PERSISTENCE_PROB, Comparison, Posterior
from tests.helpers.densities import made_up
from tests.reference.bayes import density

SWITCH_PROB = 0.01
ATTACK_PROBS = np.array([0.45, 0.25])  # two modes
OFTEN, SELDOM = PERSISTENCE_PROB[:1], np.array([ONSET_PROB])  # one
Hypothesis = tuple[frozenset[int], int]  # (L, b)


def members(n: int, group: frozenset[int]) -> np.ndarray:
    return np.isin(np.arange(n), list(group))


def subsets(n: int) -> Iterator[frozenset[int]]:
    return (frozenset(group) for size in range(n + 1) for group in combinations(range(n), size))


def drawn_evidence(n: int, likelihood: Likelihood, seed: int, count: int = 3) -> list[Comparison]:
    rng = np.random.default_rng(seed)
    groups = [group for group in subsets(n) if group]
    tables = likelihood.tables(n)
    return [
        Comparison(
            members(n, groups[rng.integers(len(groups))]),
            members(n, groups[rng.integers(len(groups))]),
            tables[rng.integers(len(tables))],
            int(rng.integers(len(likelihood.edges) - 1)),
        )
        for _ in range(count)
    ]


def probability(likelihood: Likelihood, c: Comparison, age: int, attackers: frozenset[int], b: int, a: int) -> float:
    """The slow twin of one comparison's likelihood."""
    group, reference = (frozenset(np.flatnonzero(members).tolist()) for members in (c.group, c.reference))
    return float(density(likelihood, group, reference, age, attackers, b, a)[c.bin])


def twin(
    likelihood: Likelihood, n: int, frames: list[tuple[list[Comparison], list[int], bool]]
) -> dict[Hypothesis, float]:
    """p(L, b) after frames of (comparisons, ages of their references, renewed), one case at a time."""
    sets = [attackers for attackers in subsets(n) if len(attackers) < n]
    prior = {attackers: 1 / (n * math.comb(n, len(attackers))) for attackers in sets}
    belief = {(attackers, b): prior[attackers] * (b == 0) for attackers in sets for b in range(3)}
    for comparisons, ages, renew in frames:
        after = dict.fromkeys(belief, 0.0)
        for (attackers, b), a in product(belief, range(3)):
            weight = (1 - ATTACK_PROBS.sum()) * belief[attackers, b]
            if a:
                born = SWITCH_PROB * prior[attackers] * (b == 0)
                weight = (
                    ATTACK_PROBS[a - 1]
                    * ((1 - SWITCH_PROB) * belief[attackers, b] + born)
                    * (1 if attackers else OUTLIER_PRIOR[a - 1])
                )
            for c, age in zip(comparisons, ages, strict=True):
                weight *= probability(likelihood, c, age, attackers, b, a)
            after[attackers, a if renew else b] += weight
        total = sum(after.values())
        belief = {h: weight / total for h, weight in after.items()}
    return belief


@given(st.integers(1, 5), st.integers(0, 10**6))
@settings(max_examples=10)
def test_equals_the_sum_over_every_case(n: int, seed: int) -> None:
    likelihood = made_up(seed)
    frames, posterior = [], Posterior(n, switch_prob=SWITCH_PROB, modes=2)
    for t in range(4):
        comparisons = drawn_evidence(n, likelihood, seed + t)
        by_age = likelihood.tables(n)
        comparisons = [Comparison(c.group, c.reference, by_age[t % 2], c.bin) for c in comparisons]
        frames.append((comparisons, [t % 2 + 1] * len(comparisons), t % 3 != 0))
        posterior.predict(ATTACK_PROBS)
        for comparison in comparisons:
            posterior.update(comparison)
        posterior.advance(t % 3 != 0)
    expected = twin(likelihood, n, frames)
    for attackers, row in zip(posterior.sets, posterior.density, strict=True):
        numbers = frozenset(np.flatnonzero(attackers).tolist())
        assert row == pytest.approx([expected[numbers, b] for b in range(3)], rel=1e-9, abs=1e-15)


@given(st.integers(1, 6), st.integers(0, 10**6))
@settings(max_examples=15)
def test_sums_to_one_and_the_order_of_evidence_is_nothing(n: int, seed: int) -> None:
    likelihood = made_up(seed)
    evidence = drawn_evidence(n, likelihood, seed, 4)
    one, other = Posterior(n, switch_prob=SWITCH_PROB, modes=2), Posterior(n, switch_prob=SWITCH_PROB, modes=2)
    assert one.mass.sum() == pytest.approx(1)
    for posterior, order in ((one, evidence), (other, evidence[::-1])):
        posterior.predict(ATTACK_PROBS)
        for comparison in order:
            posterior.update(comparison)
            assert posterior.mass.sum() == pytest.approx(1)
        posterior.advance(True)
        assert posterior.mass.sum() == pytest.approx(1)
    assert one.joint == pytest.approx(other.joint)


@given(st.integers(2, 6), st.integers(0, 10**6))
@settings(max_examples=15)
def test_renumbering_the_vehicles_renumbers_the_probabilities(n: int, seed: int) -> None:
    likelihood, order = made_up(seed), np.random.default_rng(seed).permutation(n)
    one, other = Posterior(n, switch_prob=SWITCH_PROB, modes=2), Posterior(n, switch_prob=SWITCH_PROB, modes=2)
    for posterior, p in ((one, np.arange(n)), (other, order)):
        posterior.predict(ATTACK_PROBS)
        for c in drawn_evidence(n, likelihood, seed):
            posterior.update(Comparison(c.group[p], c.reference[p], c.table, c.bin))
        posterior.advance(True)
    assert other.attacker_probability() == pytest.approx(one.attacker_probability()[order])


def test_a_frame_in_which_nothing_shows_acquits_nobody() -> None:
    """With a verifier that hardly errs: probabilities after clean frames are what they were before."""
    table = Verifier(1e-9, 1e-9).tables(5)[0]
    posterior, everyone, pair = Posterior(5, switch_prob=SWITCH_PROB), np.ones(5, dtype=bool), np.arange(5) < 2
    fails, passes = Comparison(pair, everyone, table, 0), Comparison(everyone, everyone, table, 1)
    posterior.predict(SELDOM)
    posterior.update(passes)
    posterior.advance(True)
    assert posterior.attacker_probability() == pytest.approx([0.4] * 5, abs=2e-3)
    posterior.predict(SELDOM)
    posterior.update(fails)
    posterior.advance(False)
    suspected = posterior.attacker_probability()
    assert suspected[0] > 0.6
    for _ in range(200):
        posterior.predict(SELDOM)
        posterior.update(passes)
        posterior.advance(True)
    assert posterior.attacker_probability() == pytest.approx(suspected, abs=2e-3)


def test_prior_by_hand() -> None:
    """n = 3: 1/3 for nobody, 1/9 for each one, 1/9 for each pair, none for all."""
    posterior = Posterior(3, switch_prob=SWITCH_PROB)
    by_number = {0: 1 / 3, 1: 1 / 9, 2: 1 / 9}
    assert len(posterior.sets) == 7
    assert posterior.prior == pytest.approx([by_number[int(s.sum())] for s in posterior.sets])
    assert posterior.attacker_probability() == pytest.approx([1 / 3] * 3)
