"""The choice of groups: information gain against its definition, and utility."""

from __future__ import annotations

import math

import numpy as np
import pytest

from defenders.bayes.acquisition import (
    FullView,
    HypothesisSample,
    Reference,
    best_collaborators,
    best_query,
    exhaustive,
    information_gain,
    local_search,
    sample_hypotheses,
)
from defenders.bayes.likelihood import FullViewTable, Likelihood, Verifier
from defenders.bayes.posterior import Posterior
from tests.defenders.bayes.test_posterior import ATTACK_PROBS, SWITCH_PROB, drawn_evidence, members, subsets
from tests.helpers.densities import made_up


def doubted(n: int, likelihood: Likelihood, seed: int) -> Posterior:
    posterior = Posterior(n, switch_prob=SWITCH_PROB, modes=likelihood.modes)
    posterior.predict(ATTACK_PROBS[: likelihood.modes])
    for comparison in drawn_evidence(n, likelihood, seed, 2):
        posterior.update(comparison)
    return posterior


def slow_gain(group: np.ndarray, reference: Reference, hypotheses: HypothesisSample) -> float:
    """Mutual information from its definition: Σ p(h) p(y | h) log2(p(y | h) / p(y)), y one or two bins."""
    given_each = []
    for h, now in enumerate(hypotheses.now):
        attackers = -1 if hypotheses.outlier[0, h] else int(now[group].sum())
        its = -1 if hypotheses.outlier[1, h] else int(hypotheses.then[h][reference.group].sum())
        sizes = int(group.sum()), int(reference.group.sum()), int(group[reference.group].sum())
        how = hypotheses.mode[:, h].tolist()
        row = int(reference.table.rows(sizes[0], np.array(attackers), sizes[1], np.array(its), sizes[2], *how))
        given = reference.table.density[row]
        if reference.full_view is not None:
            total = -1 if hypotheses.outlier[0, h] else int(now[reference.full_view.present].sum())
            row = int(reference.full_view.table.rows(sizes[0], np.array(attackers), np.array(total), how[0]))
            given = np.outer(given, reference.full_view.table.density[row]).reshape(-1)
        given_each.append(given)
    total = hypotheses.weight @ np.array(given_each)
    return sum(
        w * p * math.log2(p / t)
        for w, each in zip(hypotheses.weight, given_each, strict=True)
        for p, t in zip(each, total, strict=True)
    )


def sight(n: int, likelihood: Likelihood, *, full_view: bool) -> Reference:
    everyone = np.ones(n, dtype=bool)
    table = FullView(everyone, FullViewTable(likelihood, n)) if full_view else None
    return Reference(everyone, likelihood.tables(n)[0], table)


@pytest.mark.parametrize("full_view", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_information_equals_its_definition_and_no_group_has_more(seed: int, full_view: bool) -> None:
    n, likelihood, rng = 4, made_up(seed), np.random.default_rng(seed)
    hypotheses = sample_hypotheses(doubted(n, likelihood, seed), rng, 10**6)
    reference = sight(n, likelihood, full_view=full_view)
    groups = [members(n, group) for group in subsets(n) if 0 < len(group) < n]
    slow = [slow_gain(group, reference, hypotheses) for group in groups]
    assert information_gain(np.array(groups), reference, hypotheses) == pytest.approx(slow, rel=1e-6, abs=1e-12)
    everyone = np.ones((1, n), dtype=bool)
    query = best_query([reference], hypotheses, everyone[0], everyone, rng)
    assert query.gain == pytest.approx(max(slow), rel=1e-6)
    present = np.arange(n) != 2
    seen = np.stack([present, np.arange(n) == 0])
    query = best_query([reference], hypotheses, present, seen, rng)
    left = [not group[2] and (seen != group).any(1).all() for group in groups]
    among = [gain for gain, is_left in zip(slow, left, strict=True) if is_left]
    assert query.gain == pytest.approx(max(among), rel=1e-6) and not query.group[2]


@pytest.mark.parametrize("seed", range(5))
def test_local_search_comes_near_the_exact_one(seed: int) -> None:
    likelihood, rng = Verifier(), np.random.default_rng(seed)
    hypotheses = sample_hypotheses(doubted(5, likelihood, seed), rng, 10**6)
    reference, present = sight(5, likelihood, full_view=False), np.ones(5, dtype=bool)
    seen = present[None]
    assert (
        local_search(reference, hypotheses, present, seen, rng).gain
        >= 0.85 * exhaustive(reference, hypotheses, present, seen).gain
    )


def test_a_sample_of_hypotheses_stands_for_all() -> None:
    posterior = doubted(9, made_up(0), 0)
    hypotheses = sample_hypotheses(posterior, np.random.default_rng(0), 500)
    assert len(hypotheses.weight) <= 500 and hypotheses.weight.sum() == pytest.approx(1)
    expected = posterior.mass.sum(1)[:, 1:].sum(1) @ posterior.sets
    assert hypotheses.weight @ hypotheses.now == pytest.approx(expected, abs=0.06)


@pytest.mark.parametrize("seed", range(5))
def test_the_safest_group_is_worth_most(seed: int) -> None:
    """Against every group added up case by case, vehicle 3 being barred."""
    n, likelihood, rng = 4, made_up(seed), np.random.default_rng(seed)
    posterior = doubted(n, likelihood, seed)
    utility = np.sort(rng.random((3, n + 1, n + 2)))[:, :, ::-1]
    excluded = np.arange(n) == 3

    def expected(group: np.ndarray) -> float:
        total = 0.0
        for (h, _, a), p in np.ndenumerate(posterior.mass):
            attackers = int(posterior.sets[h][group].sum()) if a else 0
            total += p * utility[a, group.sum(), -1 if a and not posterior.sets[h].any() else attackers]
        return total

    best = best_collaborators(posterior, utility, excluded, np.ones(n, dtype=bool), rng)
    assert not (best & excluded).any()
    assert expected(best) == pytest.approx(max(expected(members(n, g)) for g in subsets(3) if g))
