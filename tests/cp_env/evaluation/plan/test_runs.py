"""The plan: every combination once, specs that can be read, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

import agents
from cp_env.evaluation import Crew, Protocol, parse, plan
from tests.helpers.toy_evaluation import PROTOCOL, SOURCE


def test_the_plan_holds_every_combination_once_and_nobody_lies_only_without_liars() -> None:
    cells = plan(
        PROTOCOL, defenders=("none", "prbi"), attacks=("none", "pgd:steps=1"), ks=(1, 2), seeds=(0, 7), batch=1
    )
    assert len(cells) == len(set(cells)) == 2 * (1 + 2) * 2 * 2  # defenders × (none, k=1, k=2) × seeds × scenes
    assert {(cell.attack, cell.k) for cell in cells} == {("none", 0), ("pgd:steps=1", 1), ("pgd:steps=1", 2)}
    slugs = {cell.slug(protocol, name) for cell in cells for protocol in variants() for name in ("", "other")}
    assert len(slugs) == len(cells) * len(variants()) * 2


def variants() -> list[Protocol]:
    """Protocols that differ in one condition each: their results must never be mixed."""
    changes: list[dict[str, Any]] = [
        {},
        {"frames": 5},
        {"budget": 0.2},
        {"norm": "l2"},
        {"rsu": True},
        {"n_vehicles": 4},
    ]
    return [replace(PROTOCOL, **change) for change in changes]


def test_a_chunk_takes_so_many_scenes() -> None:
    cells = plan(PROTOCOL, defenders=("none",), attacks=("none",), ks=(1,), seeds=(0,), batch=4)
    assert [cell.names for cell in cells] == [("toy-0", "toy-1")]


@pytest.mark.parametrize(
    ("spec", "name", "knobs"),
    [
        ("prbi", "prbi", {}),
        ("prbi:threshold=calibrated", "prbi", {"threshold": "calibrated"}),
        (
            "pgd:steps=30,step_size=0.05,random_start=False",
            "pgd",
            {"steps": 30, "step_size": 0.05, "random_start": False},
        ),
    ],
)
def test_specs_name_knobs(spec: str, name: str, knobs: dict[str, Any]) -> None:
    assert parse(spec) == (name, knobs)


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
        plan(PROTOCOL, **{**good, **change})


def test_unknown_scenes_and_an_empty_crew_are_refused() -> None:
    with pytest.raises(ValueError, match=r"unknown scenes \['nowhere'\]; known: toy-0, toy-1"):
        Protocol(SOURCE, ("nowhere",))
    with pytest.raises(ValueError, match="workers"):
        Crew(make_attacker=agents.make, workers=0)
