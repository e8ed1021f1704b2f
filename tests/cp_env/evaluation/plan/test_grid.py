"""Grids of runs: one factor at a time, or all."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from cp_env.evaluation.plan.grid import jobs_of
from tests.helpers.toy_grid import AXES, grids


def test_a_star_moves_one_axis_at_a_time_and_a_full_design_all() -> None:
    many = replace(AXES, fusions=("mean", "max"))
    assert many.points == [("mean", 0.3, 2), ("mean", 0.3, 1), ("mean", 0.1, 2), ("max", 0.3, 2)]
    assert len(replace(many, design="full").points) == len(set(replace(many, design="full").points)) == 8


def test_grids_share_what_they_have_in_common(tmp_path: Path) -> None:
    base, fewer, weaker = grids(tmp_path)
    assert {c.attack for c in base.runs} == {"none", "x", "y"} and {c.attack for c in fewer.runs} == {"none", "x"}
    assert {(b.conditions.budget, b.k) for b in (base, fewer, weaker)} == {(0.3, 2), (0.3, 1), (0.1, 2)}
    # 2 defenders × (none, x, y at the base; x at k = 1; none, x at Δ = 0.1): the cells in which nobody lies are one
    assert len(jobs_of([base, fewer, weaker])) == 2 * (3 + 1 + 2)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"design": "round"}, "one-factor-at-a-time, full"),
        ({"budgets": (0.1, 0.1)}, "budgets must be"),
        ({"off_baseline_attacks": ("q",)}, "q"),
    ],
)
def test_axes_that_make_no_sense_are_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(AXES, **change)  # type: ignore[arg-type]
