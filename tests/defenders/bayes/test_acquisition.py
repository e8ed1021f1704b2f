"""The choice of groups: the most information, against the slow twin, and the highest utility."""

from __future__ import annotations

import numpy as np
import pytest

from defenders.bayes.acquisition import best_collaborators, best_query, exhaustive, local_search
from defenders.bayes.information import FullView, Reference, sample_hypotheses
from defenders.bayes.likelihood import FullViewTable, Likelihood, Verifier
from defenders.bayes.small_fleet import list_outcomes
from tests.defenders.bayes.test_information import doubted
from tests.defenders.bayes.test_posterior import members, subsets
from tests.helpers.densities import made_up
from tests.reference.bayes import SlowReference


def sight(n: int, likelihood: Likelihood, *, full_view: bool) -> Reference:
    everyone = np.ones(n, dtype=bool)
    table = FullView(everyone, FullViewTable(likelihood, n)) if full_view else None
    return Reference(everyone, likelihood.tables(n)[0], table)


@pytest.mark.parametrize("listed", [False, True])
@pytest.mark.parametrize("full_view", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_no_group_that_is_left_has_more_information(seed: int, full_view: bool, listed: bool) -> None:
    n, likelihood, rng = 4, made_up(seed), np.random.default_rng(seed)
    hypotheses = sample_hypotheses(doubted(n, likelihood, seed), rng, 10**6)
    reference = sight(n, likelihood, full_view=full_view)
    groups = [members(n, group) for group in subsets(n) if 0 < len(group) < n]
    slow = SlowReference(
        reference.group, reference.table, reference.full_view, likelihood=likelihood, age=1
    ).information_gain(np.array(groups), hypotheses)
    reference = list_outcomes(reference) if listed else reference
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
