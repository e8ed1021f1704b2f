"""Ranks: probabilities of being first, and places that cannot be told apart."""

from __future__ import annotations

import numpy as np
import pytest

from cp_env.evaluation.analysis.ranks import first_probabilities, places

SCENES = "abcdefghijklmnopqrstu"


def table(**rows: list[float]) -> dict[str, dict[str, float]]:
    return {name: dict(zip(SCENES, values, strict=False)) for name, values in rows.items()}


def test_probabilities_of_being_first_sum_to_one_and_follow_the_means() -> None:
    rng = np.random.default_rng(0)
    for n in (2, 9, 21):
        values = {str(i): dict(zip(SCENES[:n], rng.random(n).tolist(), strict=True)) for i in range(6)}
        for lower in (True, False):
            first = first_probabilities(values, lower_is_better=lower, resamples=500)
            assert first is not None and sum(first.values()) == pytest.approx(1)
            best = next(name for name, place in places(values, lower_is_better=lower).items() if place.rank == 1)
            assert first[best] > 0


def test_two_scenes_by_hand() -> None:
    """x is first if the second scene is not drawn twice (3 of 4), y if it is (1 of 4)."""
    values = table(x=[0.0, 0.5], y=[0.6, 0.4])
    first = first_probabilities(values, lower_is_better=True, resamples=20_000)
    assert first == pytest.approx({"x": 0.75, "y": 0.25}, abs=0.015)


def test_those_that_are_equal_share_it() -> None:
    first = first_probabilities(table(x=[0.1, 0.2], y=[0.1, 0.2], z=[0.9, 0.9]), lower_is_better=True)
    assert first == pytest.approx({"x": 0.5, "y": 0.5, "z": 0.0})


def test_all_entries_are_resampled_together() -> None:
    """One is better by a little in every scene, and scenes differ much: it is always first."""
    rng = np.random.default_rng(1)
    hard = rng.random(9)
    first = first_probabilities(table(x=hard.tolist(), y=(hard + 0.01).tolist()), lower_is_better=True)
    assert first == {"x": 1.0, "y": 0.0}


def test_a_rank_that_cannot_be_told_apart_says_so() -> None:
    rng = np.random.default_rng(2)
    base = rng.random(21) * 0.2
    noise = [base + rng.normal(0, 0.02, 21) for _ in range(2)]
    found = places(
        table(worst=(base + 0.7).tolist(), a=noise[0].tolist(), b=noise[1].tolist(), middle=(base + 0.4).tolist()),
        lower_is_better=True,
    )
    assert [*found][2:] == ["middle", "worst"]
    assert {str(found["a"]), str(found["b"])} == {"1–2"} and str(found["middle"]) == "3" and str(found["worst"]) == "4"
    turned = places(table(a=base.tolist(), b=(base + 0.4).tolist()), lower_is_better=False)
    assert [(name, str(place)) for name, place in turned.items()] == [("b", "1"), ("a", "2")]


def test_few_scenes_leave_every_place_open() -> None:
    found = places(table(a=[0.0, 0.1, 0.2], b=[0.8, 0.9, 0.8], c=[0.5, 0.5, 0.5]), lower_is_better=True)
    assert [(name, place.rank, str(place)) for name, place in found.items()] == [
        ("a", 1, "1–3"),
        ("c", 2, "1–3"),
        ("b", 3, "1–3"),
    ]
    alone = places(table(a=[0.3]), lower_is_better=True)["a"]
    assert (alone.rank, str(alone), alone.first) == (1, "1", None), "from one scene nothing is resampled"
    assert places({}, lower_is_better=True) == {}


def test_the_place_lies_between_its_ends() -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        values = {str(i): dict(zip(SCENES, (rng.random() + rng.random(21)).tolist(), strict=True)) for i in range(7)}
        found = places(values, lower_is_better=True)
        assert [place.rank for place in found.values()] == list(range(1, 8))
        assert all(1 <= place.low <= place.rank <= place.high <= 7 for place in found.values())


def test_entries_of_other_scenes_are_refused() -> None:
    with pytest.raises(ValueError, match="same scenes"):
        first_probabilities({"a": {"x": 0.1}, "b": {"y": 0.1}}, lower_is_better=True)
