"""Listed references: the same information, evidence and episodes as those of references that list nothing."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from defenders import Bayes
from defenders.bayes.fleet import Fleet
from defenders.bayes.information import Reference, sample_hypotheses
from defenders.bayes.posterior import every_set
from defenders.bayes.small_fleet import every_group, list_outcomes
from defenders.simulation.world import Episode, Group, Scenario, turning
from tests.defenders.bayes.test_information import doubted, reference, slow
from tests.helpers.densities import made_up
from tests.reference.bayes import SlowReference


@pytest.mark.parametrize(("n", "size"), [(1, 10**6), (2, 10**6), (4, 10**6), (5, 10**6), (6, 10**6), (6, 512)])
@pytest.mark.parametrize(("full_view", "absent"), [(False, False), (True, False), (True, True)])
def test_information_is_that_of_any_reference(n: int, size: int, full_view: bool, absent: bool) -> None:
    if absent and n == 1:
        pytest.skip("the ego is never absent")
    for seed in range(3):
        likelihood, rng = made_up(seed), np.random.default_rng(seed)
        hypotheses = sample_hypotheses(doubted(n, likelihood, seed), rng, size)
        plain = reference(n, likelihood, seed, full_view=full_view, absent=absent)
        groups = every_group(np.ones(n, dtype=bool) if plain.full_view is None else plain.full_view.present)
        groups = rng.permutation(groups if plain.full_view is None or len(groups) == 1 else groups[:-1])
        found = list_outcomes(plain).information_gain(groups, hypotheses)
        assert found == pytest.approx(plain.information_gain(groups, hypotheses), rel=1e-9, abs=1e-12)
        one = list_outcomes(plain).information_gain(groups[:1], hypotheses)
        assert one == pytest.approx(found[:1], rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_evidence_is_that_of_any_reference_and_of_the_definition(seed: int) -> None:
    n, likelihood = 4, made_up(seed)
    plain, sets = reference(n, likelihood, seed, full_view=True, absent=seed == 2), every_set(n)
    assert plain.full_view is not None
    listed, twin = list_outcomes(plain), slow(likelihood, plain)
    for group in every_group(plain.full_view.present)[:-1]:  # the last is the full view itself
        for found in range(4):
            expected = twin.evidence(group, found).likelihood(sets)
            assert (plain.evidence(group, found).likelihood(sets) == expected).all()
            assert (listed.evidence(group, found).likelihood(sets) == expected).all()
        for found in range(3):
            expected = twin.full_view_evidence(group, found).likelihood(sets)
            assert plain.full_view_evidence(group, found).likelihood(sets) == pytest.approx(expected, rel=1e-12)
            known = listed.full_view_evidence(group, found).likelihood(sets)
            assert (known == plain.full_view_evidence(group, found).likelihood(sets)).all()


def blurred(group: Group, active: Group, rng: np.random.Generator) -> float:
    """Similarities of every bin, which tell little of a view of few vehicles."""
    return float(rng.beta(1, 4) if active else rng.beta(1 + 2 * len(group), 2))


def scenario(n: int, k: int) -> Scenario:
    """Vehicle 1 is absent now and then, and one of the attackers starts late."""
    return Scenario(
        n_vehicles=n,
        n_attackers=k,
        max_frames=5,
        similarity_model=blurred,
        schedule=turning(2),
        absent=lambda t, _: frozenset({1} if t % 3 == 2 else ()),
    )


def played(n: int, seeds: int, max_verifications: int) -> list[Episode]:
    defender = Bayes(max_verifications=max_verifications)
    return [scenario(n, k).play(defender, seed) for k in range(n) for seed in range(seeds)]


@pytest.mark.parametrize(("n", "seeds", "max_verifications"), [(3, 6, 1), (4, 4, 8), (5, 3, 2), (6, 2, 2)])
def test_episodes_are_those_of_references_that_list_nothing(
    n: int, seeds: int, max_verifications: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whole records: every query, its cost, and every verdict."""
    episodes = played(n, seeds, max_verifications)
    assert any(result.verifications for episode in episodes for result in episode.results)
    monkeypatch.setattr("defenders.bayes.fleet._kept_fleet", Fleet)  # nothing that is kept already
    monkeypatch.setattr("defenders.bayes.fleet.list_outcomes", lambda plain: plain)
    assert played(n, seeds, max_verifications) == episodes


def test_episodes_are_those_of_the_slow_twin(monkeypatch: pytest.MonkeyPatch) -> None:
    """The slow twin knows no table, no row and no kind."""
    episodes = played(3, 2, 2)
    of_fleet = Fleet._make_reference

    def slow_reference(fleet: Fleet, group: Group, age: int, present: Group | None) -> Reference:
        plain = of_fleet(fleet, group, age, present)
        return SlowReference(plain.group, plain.table, plain.full_view, likelihood=fleet.likelihood, age=age)

    monkeypatch.setattr("defenders.bayes.fleet._kept_fleet", Fleet)
    monkeypatch.setattr(Fleet, "_make_reference", slow_reference)
    assert played(3, 2, 2) == episodes


@given(st.lists(st.booleans(), min_size=1, max_size=6).filter(any))
def test_every_group_is_made_of_those_present_and_each_comes_once(present: list[bool]) -> None:
    groups = every_group(np.array(present))
    assert len({tuple(group) for group in groups.tolist()}) == len(groups) == 2 ** sum(present) - 1
    assert groups.any(1).all() and not groups[:, ~np.array(present)].any()
