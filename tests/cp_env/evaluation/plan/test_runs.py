"""The plan: every combination once, specs that can be read, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

import agents
from cp_env.evaluation import Conditions, Workers, plan_runs
from tests.helpers.toy_evaluation import CONDITIONS, SOURCE


def test_the_plan_holds_every_combination_once_and_no_attack_without_attackers() -> None:
    runs = plan_runs(
        CONDITIONS, defenders=("none", "prbi"), attacks=("none", "pgd:steps=1"), ks=(1, 2), seeds=(0, 7), batch=1
    )
    assert len(runs) == len(set(runs)) == 2 * (1 + 2) * 2 * 2  # defenders × (none, k=1, k=2) × seeds × scenes
    assert {(run.attack, run.k) for run in runs} == {("none", 0), ("pgd:steps=1", 1), ("pgd:steps=1", 2)}
    slugs = {run.slug(conditions, name) for run in runs for conditions in variants() for name in ("", "other")}
    assert len(slugs) == len(runs) * len(variants()) * 2


def variants() -> list[Conditions]:
    """Conditions that differ in one value each: their results must never be mixed."""
    changes: list[dict[str, Any]] = [
        {},
        {"frames": 5},
        {"budget": 0.2},
        {"norm": "l2"},
        {"rsu": True},
        {"n_vehicles": 4},
    ]
    return [replace(CONDITIONS, **change) for change in changes]


def test_a_chunk_takes_so_many_scenes() -> None:
    runs = plan_runs(CONDITIONS, defenders=("none",), attacks=("none",), ks=(1,), seeds=(0,), batch=4)
    assert [run.names for run in runs] == [("toy-0", "toy-1")]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"ks": (0,)}, "at least 1"),
        ({"ks": (5,)}, "0 <= k < n"),
        ({"ks": (1, 1)}, "distinct"),
        ({"seeds": ()}, "at least one"),
        ({"defenders": ("prbi:window=5,epsilon",)}, "cannot read"),
        ({"batch": 0}, "batch"),
    ],
)
def test_a_plan_that_cannot_be_played_is_refused(change: dict[str, Any], message: str) -> None:
    good: dict[str, Any] = {"defenders": ("none",), "attacks": ("pgd",), "ks": (1,), "seeds": (0,)}
    with pytest.raises(ValueError, match=message):
        plan_runs(CONDITIONS, **{**good, **change})


def test_unknown_scenes_and_no_workers_are_refused() -> None:
    with pytest.raises(ValueError, match=r"unknown scenes \['nowhere'\]; known: toy-0, toy-1"):
        Conditions(SOURCE, ("nowhere",))
    with pytest.raises(ValueError, match="processes"):
        Workers(make_attack=agents.make, processes=0)
