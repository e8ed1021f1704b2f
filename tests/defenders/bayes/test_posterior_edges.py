"""What is read off a posterior, and the full view's evidence, against sums over one hypothesis at a time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from defenders.bayes.likelihood import FullViewTable
from defenders.bayes.posterior import Comparison, FullViewComparison, Posterior
from tests.helpers.densities import made_up

MODES = 2
ATTACK_PROBS = np.array([0.45, 0.25])


def informed(n: int, seed: int) -> Posterior:
    """A posterior in the middle of a frame, after one frame with evidence and one in which references were renewed."""
    rng, likelihood = np.random.default_rng(seed), made_up(seed)
    posterior, table = Posterior(n, switch_prob=0.01, modes=MODES), likelihood.tables(n)[0]
    for frame in range(3):
        if frame:
            posterior.advance(frame == 1)
        posterior.predict(ATTACK_PROBS)
        for _ in range(2):
            group, reference = (np.arange(n) < size for size in rng.integers(1, n + 1, 2))
            posterior.update(Comparison(group, reference, table, int(rng.integers(4))))
    return posterior


def hypotheses(posterior: Posterior) -> Iterator[tuple[frozenset[int], int, int, float]]:
    """(L, b, a) and its mass."""
    for attackers, rows in zip(posterior.sets, posterior.mass, strict=True):
        for b, a in np.ndindex(rows.shape):
            yield frozenset(np.flatnonzero(attackers).tolist()), b, a, float(rows[b, a])


@given(st.integers(2, 5), st.integers(0, 10**6))
@settings(max_examples=15)
def test_an_attack_needs_attackers_and_an_outlier_is_none(n: int, seed: int) -> None:
    posterior = informed(n, seed)
    for mode in range(1, MODES + 1):
        expected = sum(mass for attackers, _, a, mass in hypotheses(posterior) if attackers and a == mode)
        assert posterior.attack_probs()[mode - 1] == pytest.approx(expected)


@given(st.integers(2, 5), st.integers(0, 10**6), st.booleans())
@settings(max_examples=25)
def test_a_view_is_contaminated_by_who_attacks_in_its_own_frame(n: int, seed: int, now: bool) -> None:
    """An outlier contaminates every view."""
    posterior = informed(n, seed)
    members = np.random.default_rng(seed).random(n) < 0.5
    group = frozenset(np.flatnonzero(members).tolist())
    contaminated = sum(
        mass
        for attackers, b, a, mass in hypotheses(posterior)
        if (a if now else b) and (group & attackers or not attackers)
    )
    found = posterior.uncontaminated_probability(np.stack([~members, members]), now=now)
    assert found[1] == pytest.approx(1 - contaminated)


@given(st.integers(3, 5), st.integers(0, 10**6))
@settings(max_examples=25)
def test_the_full_view_shows_the_attackers_that_are_present(n: int, seed: int) -> None:
    rng, likelihood, sets = np.random.default_rng(seed), made_up(seed), Posterior(n, switch_prob=0.01).sets
    order = rng.permutation(n)
    count = int(rng.integers(2, n))  # present, never all
    present = np.isin(np.arange(n), order[:count])
    group = np.isin(np.arange(n), order[: int(rng.integers(1, count))])
    table, found = FullViewTable(likelihood, count), int(rng.integers(3))
    likelihoods = FullViewComparison(group, present, table, found).likelihood(sets)
    size = int(group.sum())
    for attackers, rows in zip(sets, likelihoods, strict=True):
        inside, total = int((attackers & group).sum()), int((attackers & present).sum())
        for b, a in np.ndindex(rows.shape):
            if a and not attackers.any():
                row = table.density[int(table.rows(size, np.array(-1), np.array(-1), a))]
            else:
                row = likelihood.full_view(size, inside if a else 0, count, total if a else 0, max(a, 1))
            assert rows[b, a] == pytest.approx(row[found])
