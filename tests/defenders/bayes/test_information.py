"""Expected information against its definition, and samples of hypotheses."""

from __future__ import annotations

import numpy as np
import pytest

from defenders.bayes.information import FullView, Reference, sample_hypotheses
from defenders.bayes.likelihood import FullViewTable, Likelihood
from defenders.bayes.posterior import Posterior
from tests.defenders.bayes.test_posterior import ATTACK_PROBS, SWITCH_PROB, drawn_evidence, members, subsets
from tests.helpers.densities import made_up
from tests.reference.bayes import SlowReference


def doubted(n: int, likelihood: Likelihood, seed: int) -> Posterior:
    posterior = Posterior(n, switch_prob=SWITCH_PROB, modes=likelihood.modes)
    for frame in range(2):
        posterior.predict(ATTACK_PROBS[: likelihood.modes])
        for comparison in drawn_evidence(n, likelihood, seed + frame, 2):
            posterior.update(comparison)
        if not frame:
            posterior.advance(True)
    return posterior


def reference(n: int, likelihood: Likelihood, seed: int, *, full_view: bool, absent: bool = False) -> Reference:
    """Of vehicles and an age drawn at random."""
    rng = np.random.default_rng(seed)
    group, age = members(n, frozenset(rng.permutation(n)[: rng.integers(1, n + 1)].tolist())), int(rng.integers(2))
    present = np.arange(n) != (n - 1 if absent else n)
    shown = FullView(present, FullViewTable(likelihood, int(present.sum()))) if full_view else None
    return Reference(group, likelihood.tables(n)[age], shown)


def slow(likelihood: Likelihood, fast: Reference) -> SlowReference:
    """The slow twin."""
    n = len(fast.group)
    (age,) = (
        age
        for age, table in enumerate(likelihood.tables(n), start=1)
        if table.density.shape == fast.table.density.shape and (table.density == fast.table.density).all()
    )
    return SlowReference(fast.group, fast.table, fast.full_view, likelihood=likelihood, age=age)


def every_group_but_all(n: int) -> np.ndarray:
    return np.array([members(n, group) for group in subsets(n) if 0 < len(group) < n])


@pytest.mark.parametrize("full_view", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_information_equals_its_definition(seed: int, full_view: bool) -> None:
    n, likelihood, rng = 4, made_up(seed), np.random.default_rng(seed)
    hypotheses = sample_hypotheses(doubted(n, likelihood, seed), rng, 10**6)
    fast = reference(n, likelihood, seed, full_view=full_view)
    groups = every_group_but_all(n)
    expected = slow(likelihood, fast).information_gain(groups, hypotheses)
    assert fast.information_gain(groups, hypotheses) == pytest.approx(expected, rel=1e-9, abs=1e-12)
    assert (expected > 1e-3).any()


def test_a_sample_of_hypotheses_stands_for_all() -> None:
    posterior = doubted(9, made_up(0), 0)
    hypotheses = sample_hypotheses(posterior, np.random.default_rng(0), 500)
    assert len(hypotheses.weight) <= 500 and hypotheses.weight.sum() == pytest.approx(1)
    expected = posterior.mass.sum(1)[:, 1:].sum(1) @ posterior.sets
    assert hypotheses.weight @ hypotheses.now == pytest.approx(expected, abs=0.06)


def test_hypotheses_are_attackers_and_modes_of_both_frames() -> None:
    posterior = doubted(3, made_up(1), 1)
    hypotheses = sample_hypotheses(posterior, np.random.default_rng(0), 10**6)
    found = zip(hypotheses.now, hypotheses.then, hypotheses.mode.T, hypotheses.outlier.T, strict=True)
    for (now, then, (a, b), outlier), ((h, its_b, its_a), mass), weight in zip(
        found, ((i, mass) for i, mass in np.ndenumerate(posterior.mass) if mass > 0), hypotheses.weight, strict=True
    ):
        attackers = posterior.sets[h]
        assert (a, b, weight) == (its_a, its_b, mass)
        assert now.tolist() == (attackers * bool(a)).tolist() and then.tolist() == (attackers * bool(b)).tolist()
        assert outlier.tolist() == [not attackers.any() and bool(a), not attackers.any() and bool(b)]
