"""The posterior over sets of liars and the choice of groups: laws, and slow twins that add up every case by itself."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import combinations, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from defenders.bayes.acquisition import (
    Aside,
    Outlook,
    Reference,
    best_look,
    climb,
    exhaustive,
    gains,
    outlook,
    safest,
)
from defenders.bayes.likelihood import BesideTable, Likelihood, Verifier
from defenders.bayes.particles import Particles, drawn
from defenders.bayes.posterior import GLITCH, STARTS, STAYS, Comparison, Posterior
from tests.helpers.densities import made_up

TURN = 0.01
LYING = np.array([0.45, 0.25])  # two manners
OFTEN, SELDOM = STAYS[:1], np.array([STARTS])  # one
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


def probability(likelihood: Likelihood, c: Comparison, age: int, liars: frozenset[int], b: int, a: int) -> float:
    """The slow twin of one comparison's likelihood, read off its definition."""
    group, reference = frozenset(np.flatnonzero(c.group)), frozenset(np.flatnonzero(c.reference))
    if not liars and (a or b):
        one, other = (min(len(members), likelihood.most) for members in (group, reference))
        return float(likelihood.glitch(one, other, a or b)[c.bin])
    now, then = len(group & liars) if a else 0, len(reference & liars) if b else 0
    if now and then:
        return float(likelihood.both(len(group), len(reference), a, b)[c.bin])
    if now:
        return float(likelihood.dirty(len(group), now, len(reference), a)[c.bin])
    if then:
        return float(likelihood.dirty(len(reference), then, len(group), b)[c.bin])
    return float(likelihood.clean(len(group), len(reference), len(group & reference), age)[c.bin])


def twin(
    likelihood: Likelihood, n: int, frames: list[tuple[list[Comparison], list[int], bool]]
) -> dict[Hypothesis, float]:
    """p(L, b) after frames of (comparisons, ages of their references, renewed), one case at a time."""
    sets = [liars for liars in subsets(n) if len(liars) < n]
    prior = {liars: 1 / (n * math.comb(n, len(liars))) for liars in sets}
    belief = {(liars, b): prior[liars] * (b == 0) for liars in sets for b in range(3)}
    for comparisons, ages, renew in frames:
        after = dict.fromkeys(belief, 0.0)
        for (liars, b), a in product(belief, range(3)):
            weight = (1 - LYING.sum()) * belief[liars, b]
            if a:
                born = TURN * prior[liars] * (b == 0)
                weight = LYING[a - 1] * ((1 - TURN) * belief[liars, b] + born) * (1 if liars else GLITCH[a - 1])
            for c, age in zip(comparisons, ages, strict=True):
                weight *= probability(likelihood, c, age, liars, b, a)
            after[liars, a if renew else b] += weight
        total = sum(after.values())
        belief = {h: weight / total for h, weight in after.items()}
    return belief


@given(st.integers(1, 5), st.integers(0, 10**6))
@settings(max_examples=10)
def test_equals_the_sum_over_every_case(n: int, seed: int) -> None:
    likelihood = made_up(seed)
    frames, posterior = [], Posterior(n, turn=TURN, manners=2)
    for t in range(4):
        comparisons = drawn_evidence(n, likelihood, seed + t)
        by_age = likelihood.tables(n)
        comparisons = [Comparison(c.group, c.reference, by_age[t % 2], c.bin) for c in comparisons]
        frames.append((comparisons, [t % 2 + 1] * len(comparisons), t % 3 != 0))
        posterior.predict(LYING)
        for comparison in comparisons:
            posterior.update(comparison)
        posterior.advance(t % 3 != 0)
    expected = twin(likelihood, n, frames)
    for liars, row in zip(posterior.sets, posterior.density, strict=True):
        numbers = frozenset(np.flatnonzero(liars).tolist())
        assert row == pytest.approx([expected[numbers, b] for b in range(3)], rel=1e-9, abs=1e-15)


@given(st.integers(1, 6), st.integers(0, 10**6))
@settings(max_examples=15)
def test_sums_to_one_and_the_order_of_evidence_is_nothing(n: int, seed: int) -> None:
    likelihood = made_up(seed)
    evidence = drawn_evidence(n, likelihood, seed, 4)
    one, other = Posterior(n, turn=TURN, manners=2), Posterior(n, turn=TURN, manners=2)
    assert one.mass.sum() == pytest.approx(1)
    for posterior, order in ((one, evidence), (other, evidence[::-1])):
        posterior.predict(LYING)
        for comparison in order:
            posterior.update(comparison)
            assert posterior.mass.sum() == pytest.approx(1)
        posterior.advance(True)
        assert posterior.mass.sum() == pytest.approx(1)
    assert one.joint == pytest.approx(other.joint)


@given(st.integers(2, 6), st.integers(0, 10**6))
@settings(max_examples=15)
def test_renumbering_the_vehicles_renumbers_the_guilt(n: int, seed: int) -> None:
    likelihood, order = made_up(seed), np.random.default_rng(seed).permutation(n)
    one, other = Posterior(n, turn=TURN, manners=2), Posterior(n, turn=TURN, manners=2)
    for posterior, p in ((one, np.arange(n)), (other, order)):
        posterior.predict(LYING)
        for c in drawn_evidence(n, likelihood, seed):
            posterior.update(Comparison(c.group[p], c.reference[p], c.table, c.bin))
        posterior.advance(True)
    assert other.guilt() == pytest.approx(one.guilt()[order])


def test_a_frame_in_which_nothing_shows_acquits_nobody() -> None:
    """With a verifier that hardly errs: guilt after clean frames is what it was before them."""
    table = Verifier(1e-9, 1e-9).tables(5)[0]
    posterior, everyone, pair = Posterior(5, turn=TURN), np.ones(5, dtype=bool), np.arange(5) < 2
    fails, passes = Comparison(pair, everyone, table, 0), Comparison(everyone, everyone, table, 1)
    posterior.predict(SELDOM)
    posterior.update(passes)
    posterior.advance(True)
    assert posterior.guilt() == pytest.approx([0.4] * 5, abs=2e-3)
    posterior.predict(SELDOM)
    posterior.update(fails)
    posterior.advance(False)
    suspected = posterior.guilt()
    assert suspected[0] > 0.6
    for _ in range(200):
        posterior.predict(SELDOM)
        posterior.update(passes)
        posterior.advance(True)
    assert posterior.guilt() == pytest.approx(suspected, abs=2e-3)


def test_prior_by_hand() -> None:
    """n = 3: 1/3 for nobody, 1/9 for each one, 1/9 for each pair, none for all."""
    posterior = Posterior(3, turn=TURN)
    by_number = {0: 1 / 3, 1: 1 / 9, 2: 1 / 9}
    assert len(posterior.sets) == 7
    assert posterior.prior == pytest.approx([by_number[int(s.sum())] for s in posterior.sets])
    assert posterior.guilt() == pytest.approx([1 / 3] * 3)


@pytest.mark.parametrize("seed", range(3))
def test_particles_are_near_the_exact_posterior(seed: int) -> None:
    n, table = 7, Verifier(0.05, 0.05).tables(7)[0]
    rng = np.random.default_rng(seed)
    exact, sample = Posterior(n, turn=TURN), Particles(n, turn=TURN, size=4000, rng=rng)
    everyone = np.ones(n, dtype=bool)
    for posterior in (exact, sample):
        drawing = np.random.default_rng(seed)
        for t in range(6):
            posterior.predict(OFTEN)
            posterior.update(Comparison(everyone, everyone, table, int(t % 3 == 0)))
            for _ in range(2):
                group = drawing.random(n) < 0.3
                group[drawing.integers(n)] = True
                posterior.update(Comparison(group, everyone, table, int(not group[2])))
            posterior.advance(t % 2 == 0)
            assert posterior.mass.sum() == pytest.approx(1, abs=1e-6)
    assert sample.guilt() == pytest.approx(exact.guilt(), abs=0.1)
    assert sample.likeliest() == pytest.approx(exact.likeliest(), abs=0.1)


def test_particles_replay_what_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("defenders.bayes.particles.MEMORY", 6)
    table, everyone = Verifier().tables(9)[0], np.ones(9, dtype=bool)
    sample = Particles(9, turn=TURN, size=100, rng=np.random.default_rng(0))
    for t in range(15):  # beyond what is remembered: a summary takes its place
        sample.predict(OFTEN)
        sample.update(Comparison(everyone, everyone, table, int(t in (0, 8, 9))))
        sample.update(Comparison(np.arange(9) == t % 9, everyone, table, int(t % 9 != 4 or t in (0, 8, 9))))
        sample.advance(t % 2 == 0)
        assert sample.replay(sample.sets) == pytest.approx(sample.density, rel=1e-6)


@given(st.integers(1, 30), st.integers(0, 10**6))
def test_particles_are_drawn_from_the_prior(n: int, seed: int) -> None:
    numbers = drawn(n, 10 * n, np.random.default_rng(seed)).sum(1)
    assert np.bincount(numbers, minlength=n).tolist() == [10] * n


# -- the choice of groups ------------------------------------------------------------------------------------------


def doubted(n: int, likelihood: Likelihood, seed: int) -> Posterior:
    posterior = Posterior(n, turn=TURN, manners=likelihood.manners)
    posterior.predict(LYING[: likelihood.manners])
    for comparison in drawn_evidence(n, likelihood, seed, 2):
        posterior.update(comparison)
    return posterior


def slow_gain(group: np.ndarray, reference: Reference, of: Outlook) -> float:
    """Mutual information from its definition: Σ p(h) p(y | h) log2(p(y | h) / p(y)), y a bin, or two with one aside."""
    given_each = []
    for h, now in enumerate(of.now):
        liars = -1 if of.glitch[0, h] else int(now[group].sum())
        its = -1 if of.glitch[1, h] else int(of.then[h][reference.group].sum())
        sizes = int(group.sum()), int(reference.group.sum()), int(group[reference.group].sum())
        how = of.manner[:, h].tolist()
        row = int(reference.table.rows(sizes[0], np.array(liars), sizes[1], np.array(its), sizes[2], *how))
        given = reference.table.density[row]
        if reference.aside is not None:
            lying = -1 if of.glitch[0, h] else int(now[reference.aside.present].sum())
            row = int(reference.aside.table.rows(sizes[0], np.array(liars), np.array(lying), how[0]))
            given = np.outer(given, reference.aside.table.density[row]).reshape(-1)
        given_each.append(given)
    total = of.weight @ np.array(given_each)
    return sum(
        w * p * math.log2(p / t)
        for w, each in zip(of.weight, given_each, strict=True)
        for p, t in zip(each, total, strict=True)
    )


def sight(n: int, likelihood: Likelihood, *, aside: bool) -> Reference:
    everyone = np.ones(n, dtype=bool)
    beside = Aside(everyone, BesideTable(likelihood, n)) if aside else None
    return Reference(everyone, likelihood.tables(n)[0], beside)


@pytest.mark.parametrize("aside", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_information_equals_its_definition_and_no_group_tells_more(seed: int, aside: bool) -> None:
    n, likelihood, rng = 4, made_up(seed), np.random.default_rng(seed)
    of = outlook(doubted(n, likelihood, seed), rng, 10**6)
    reference = sight(n, likelihood, aside=aside)
    groups = [members(n, group) for group in subsets(n) if 0 < len(group) < n]
    slow = [slow_gain(group, reference, of) for group in groups]
    assert gains(np.array(groups), reference, of) == pytest.approx(slow, rel=1e-6, abs=1e-12)
    everyone = np.ones((1, n), dtype=bool)
    look = best_look([reference], of, everyone[0], everyone, rng)
    assert look.gain == pytest.approx(max(slow), rel=1e-6)
    present = np.arange(n) != 2
    seen = np.stack([present, np.arange(n) == 0])
    look = best_look([reference], of, present, seen, rng)
    left = [not group[2] and (seen != group).any(1).all() for group in groups]
    among = [gain for gain, is_left in zip(slow, left, strict=True) if is_left]
    assert look.gain == pytest.approx(max(among), rel=1e-6) and not look.group[2]


@pytest.mark.parametrize("seed", range(5))
def test_local_search_comes_near_the_exact_one(seed: int) -> None:
    likelihood, rng = Verifier(), np.random.default_rng(seed)
    of = outlook(doubted(5, likelihood, seed), rng, 10**6)
    reference, present = sight(5, likelihood, aside=False), np.ones(5, dtype=bool)
    seen = present[None]
    assert climb(reference, of, present, seen, rng).gain >= 0.85 * exhaustive(reference, of, present, seen).gain


def test_a_sample_of_hypotheses_stands_for_all() -> None:
    posterior = doubted(9, made_up(0), 0)
    of = outlook(posterior, np.random.default_rng(0), 500)
    assert len(of.weight) <= 500 and of.weight.sum() == pytest.approx(1)
    lying = posterior.mass.sum(1)[:, 1:].sum(1) @ posterior.sets
    assert of.weight @ of.now == pytest.approx(lying, abs=0.06)


@pytest.mark.parametrize("seed", range(5))
def test_the_safest_group_is_worth_most(seed: int) -> None:
    """Against every group added up case by case, vehicle 3 being barred."""
    n, likelihood, rng = 4, made_up(seed), np.random.default_rng(seed)
    posterior = doubted(n, likelihood, seed)
    worth = np.sort(rng.random((3, n + 1, n + 2)))[:, :, ::-1]
    barred = np.arange(n) == 3

    def expected(group: np.ndarray) -> float:
        total = 0.0
        for (h, _, a), p in np.ndenumerate(posterior.mass):
            liars = int(posterior.sets[h][group].sum()) if a else 0
            total += p * worth[a, group.sum(), -1 if a and not posterior.sets[h].any() else liars]
        return total

    best = safest(posterior, worth, barred, np.ones(n, dtype=bool), rng)
    assert not (best & barred).any()
    assert expected(best) == pytest.approx(max(expected(members(n, g)) for g in subsets(3) if g))
