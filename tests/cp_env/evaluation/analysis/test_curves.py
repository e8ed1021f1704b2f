"""Curves over the number of attackers and the budget."""

from __future__ import annotations

from pathlib import Path

import pytest

from cp_env.evaluation.analysis.curves import curves
from tests.helpers.toy_grid import grids, made


def test_curves_compare_the_attacks_and_scenes_that_every_point_has(tmp_path: Path) -> None:
    results = list(zip(grids(tmp_path), ({}, {}, {}), strict=True))
    results = [(grid, made(grid, damage)) for (grid, _), damage in zip(results, (0.4, 0.2, 0.1), strict=True)]
    along_k, along_delta = curves(results)
    assert (along_k.axis, along_k.values, along_delta.axis, along_delta.values) == ("k", (1, 2), "budget", (0.1, 0.3))
    assert along_k.attacks == ("x",) and along_k.n_scenes == 2  # y is at the base only
    assert [figure.mean for figure in along_k.damage["d"]] == pytest.approx([0.2, 0.4])
    assert [figure.mean for figure in along_delta.damage["e"]] == pytest.approx([0.1, 0.4])
