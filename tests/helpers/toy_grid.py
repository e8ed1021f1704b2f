"""A small grid of runs, and records as if it had been played."""

from __future__ import annotations

from pathlib import Path

from cp_env.evaluation import Record, Run, Store
from cp_env.evaluation.plan.grid import Axes, Grid
from tests.helpers.toy_evaluation import CONDITIONS, record

AXES = Axes(defenders=("d", "e"), attacks=("x", "y"), ks=(2, 1), budgets=(0.3, 0.1), off_baseline_attacks=("x",))


def grids(folder: Path, axes: Axes = AXES) -> list[Grid]:
    return axes.grids(CONDITIONS, {fusion: Store(folder) for fusion in axes.fusions})


def made(grid: Grid, damage: float) -> dict[Run, tuple[Record, ...]]:
    """Records as if the grid had been played: each attack does the damage in every frame, y half as much again."""
    return {
        run: tuple(
            record(s, "1", 1, damage=(0.0, (1.5 if run.attack == "y" else 1.0) * damage * (run.attack != "none")))
            for s in run.names
        )
        for run in grid.runs
    }
