"""Worst cases over one axis, the others at their baseline: Δ, number of attackers, fusion."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from cp_env.evaluation.analysis.worst_case import Scores, average_precisions, damages, extremes, mean_interval
from cp_env.evaluation.plan.grid import Grid, Results
from cp_env.metrics.intervals import Interval

AXES = {"fusion": "fusion", "budget": "Δ, the bound of ‖δ‖", "k": "k, malicious vehicles"}
"""Axes in the order of `Grid.point`, and their labels in plots: a symbol, and what it is."""


@dataclass(frozen=True)
class Curve:
    """Worst cases over an axis, for the attacks and scenes that all of its grids have in common."""

    axis: str  # of `AXES`
    values: tuple[str | float, ...]  # ascending, unless they are names
    attacks: tuple[str, ...]
    n_scenes: int
    damage: Mapping[str, tuple[Interval, ...]]  # per frame, by defender
    ap50: Mapping[str, tuple[Interval, ...]]

    @property
    def symbol(self) -> str:
        return AXES[self.axis].partition(",")[0]


def curves(grids: Sequence[tuple[Grid, Results]]) -> list[Curve]:
    """One curve for every axis on which the grids, the baseline first, hold more than one value: k, Δ, fusion."""
    made = []
    for place, axis in reversed(list(enumerate(AXES))):
        base = grids[0][0].point
        arm = [(b, results) for b, results in grids if all(b.point[i] == base[i] for i in range(3) if i != place)]
        if len(arm) > 1:
            if axis != "fusion":
                arm = sorted(arm, key=lambda pair: pair[0].point[place])
            made.append(_curve(axis, tuple(grid.point[place] for grid, _ in arm), arm))
    return [curve for curve in made if curve is not None]


def _curve(axis: str, values: tuple[str | float, ...], arm: Sequence[tuple[Grid, Results]]) -> Curve | None:
    damage, ap50 = ([metric(grid, results) for grid, results in arm] for metric in (damages, average_precisions))
    attacks = _common([[*by_attack] for table in damage for by_attack in table.values()])
    scenes = _common([[*scene] for table in damage for by in table.values() for scene in by.values()])
    defenders = _common([[*table] for table in damage])
    if not (attacks and scenes and defenders):
        return None

    def line(
        tables: Sequence[Scores], defender: str, choose: Callable[[Sequence[float]], float]
    ) -> tuple[Interval, ...]:
        cut = [{a: {s: table[defender][a][s] for s in scenes} for a in attacks} for table in tables]
        return tuple(mean_interval(extremes(by_attack, choose)) for by_attack in cut)

    return Curve(
        axis,
        values,
        tuple(attacks),
        len(scenes),
        {defender: line(damage, defender, max) for defender in defenders},
        {defender: line(ap50, defender, min) for defender in defenders},
    )


def _common(lists: Sequence[Sequence[str]]) -> list[str]:
    """The items that all lists hold, in the order of the first."""
    return [item for item in lists[0] if all(item in other for other in lists)] if lists else []
