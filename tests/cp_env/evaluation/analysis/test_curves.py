"""Curves over the number of attackers and the budget."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from cp_env.evaluation.analysis.curves import curves
from tests.helpers.toy_grid import AXES, grids, made


def test_curves_compare_the_attacks_and_scenes_that_every_point_has(tmp_path: Path) -> None:
    results = list(zip(grids(tmp_path), ({}, {}, {}), strict=True))
    results = [(grid, made(grid, damage)) for (grid, _), damage in zip(results, (0.4, 0.2, 0.1), strict=True)]
    along_k, along_delta = curves(results)
    assert (along_k.axis, along_k.values, along_delta.axis, along_delta.values) == ("k", (1, 2), "budget", (0.1, 0.3))
    assert along_k.attacks == ("x",) and along_k.n_scenes == 2  # y is at the base only
    assert [figure.mean for figure in along_k.damage["d"]] == pytest.approx([0.2, 0.4])
    assert [figure.mean for figure in along_delta.damage["e"]] == pytest.approx([0.1, 0.4])
    assert along_k.under == "under x"


def test_a_curve_names_the_attacks_that_it_is_made_of(tmp_path: Path) -> None:
    axes = replace(AXES, off_baseline_attacks=())
    results = [(grid, made(grid, damage)) for grid, damage in zip(grids(tmp_path, axes), (0.4, 0.2, 0.1), strict=True)]
    looked_up, _ = curves(results)
    assert looked_up.under == "under the worst of x, y in each scene" and not looked_up.screened
    assert [figure.mean for figure in looked_up.damage["d"]] == pytest.approx([0.3, 0.6]), "y does half as much again"


def test_screened_each_defender_is_under_the_attack_that_was_picked_elsewhere(tmp_path: Path) -> None:
    axes = replace(AXES, off_baseline_attacks=())
    results = [(grid, made(grid, damage)) for grid, damage in zip(grids(tmp_path, axes), (0.4, 0.2, 0.1), strict=True)]
    screening = {"d": {"x": {"c": 0.9}, "y": {"c": 0.1}}, "e": {"x": {"c": 0.0}, "y": {"c": 0.1}}}
    along_k, _ = curves(results, screening)
    assert along_k.screened == {"d": "x", "e": "y"}
    assert along_k.under == "under the attack that was worst on the screening scenes (x: d; y: e)"
    assert [figure.mean for figure in along_k.damage["d"]] == pytest.approx([0.2, 0.4])
    assert [figure.mean for figure in along_k.damage["e"]] == pytest.approx([0.3, 0.6])
