"""Expectation over the groups that a defence may form."""

from __future__ import annotations

import pytest

from agents.attacks.adaptive import eot
from tests.helpers import situations
from tests.helpers.attacked_scenes import MODEL, act


def test_the_groups_of_each_defence() -> None:
    assert [sorted(g) for g in eot.teams(4, 2)] == [[0, 1], [0, 2], [0, 3]]
    assert {frozenset({0, 1}), frozenset({0, 2, 3})} <= set(eot.halves(4))
    assert len(eot.halves(5)) == 6 and all(0 in g and len(g) == 3 for g in eot.halves(5))
    assert len(eot.splits(5, 2)) == 20 and frozenset({0, 1, 2}) in eot.splits(5, 2)
    groups, weights = eot.group_distribution(
        situations.situation(MODEL), [[frozenset({0})] * 3 + [frozenset({1, 2})], [frozenset({3})]]
    )
    assert weights[:, :2].tolist() == [[0.75, 0.25], [1.0, 0.0]] and not weights[:, 2:].any()
    assert groups[0, :2].int().tolist() == [[1, 0, 0, 0], [0, 1, 1, 0]]
    with pytest.raises(ValueError, match="no teams of size 9"):
        act("eot", situations.situation(MODEL), groups="teams", size=9)


def test_expectation_over_teams_beats_everyone_on_the_worst_team() -> None:
    situation = situations.situation(MODEL, n_worlds=4)
    target_groups = eot.drawn_from("teams", 2)
    plain, expected = (
        situations.value(situation, act(name, situation, **options), target_groups=target_groups).mean()
        for name, options in (("bim", {}), ("eot", {"groups": "teams", "size": 2, "random_start": False}))
    )
    assert expected > plain
