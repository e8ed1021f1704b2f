"""Worst cases over one axis, the others at their baseline: Δ, number of attackers, fusion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from cp_env.evaluation.analysis.measures import measure_of
from cp_env.evaluation.analysis.worst_case import Scores, mean_interval, measured, screened_attacks, worst_values
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
    screened: Mapping[str, str] = field(default_factory=dict)  # the attack that each defender is under, if screened

    @property
    def symbol(self) -> str:
        return AXES[self.axis].partition(",")[0]

    @property
    def under(self) -> str:
        """The attacks that the curve is made of, and how they were chosen."""
        if len(self.attacks) == 1:
            return f"under {self.attacks[0]}"
        if not self.screened:
            return f"under the worst of {', '.join(self.attacks)} in each scene"
        by_attack = {
            attack: [name for name, worst in self.screened.items() if worst == attack] for attack in self.attacks
        }
        named = "; ".join(f"{attack}: {', '.join(names)}" for attack, names in by_attack.items() if names)
        return f"under the attack that was worst on the screening scenes ({named})"


def curves(grids: Sequence[tuple[Grid, Results]], screening: Scores | None = None) -> list[Curve]:
    """One curve for every axis on which the grids, the baseline first, hold more than one value: k, Δ, fusion.

    Args:
        grids: and their results.
        screening: damage on the screening scenes. Each defender is then under the attack that was worst for it there,
            of those that the curve has; otherwise under the worst one of each scene.
    """
    made = []
    for place, axis in reversed(list(enumerate(AXES))):
        base = grids[0][0].point
        arm = [(b, results) for b, results in grids if all(b.point[i] == base[i] for i in range(3) if i != place)]
        if len(arm) > 1:
            if axis != "fusion":
                arm = sorted(arm, key=lambda pair: pair[0].point[place])
            made.append(_curve(axis, tuple(grid.point[place] for grid, _ in arm), arm, screening))
    return [curve for curve in made if curve is not None]


def _curve(
    axis: str, values: tuple[str | float, ...], arm: Sequence[tuple[Grid, Results]], screening: Scores | None
) -> Curve | None:
    tables = [measured(grid, results, ("damage", "ap50")) for grid, results in arm]
    damage = [table["damage"] for table in tables]
    attacks = _common([[*by_attack] for table in damage for by_attack in table.values()])
    scenes = _common([[*scene] for table in damage for by in table.values() for scene in by.values()])
    defenders = _common([[*table] for table in damage])
    if not (attacks and scenes and defenders):
        return None
    screened = {}
    if screening is not None:
        cut = {d: {a: of for a, of in screening.get(d, {}).items() if a in attacks} for d in defenders}
        screened = screened_attacks(cut, "damage", damage[0])

    def line(measure: str, defender: str) -> tuple[Interval, ...]:
        cut = [{a: {s: table[measure][defender][a][s] for s in scenes} for a in attacks} for table in tables]
        chosen = measure_of(measure), screened.get(defender)
        return tuple(mean_interval(worst_values(by_attack, *chosen)) for by_attack in cut)

    return Curve(
        axis,
        values,
        tuple(attacks),
        len(scenes),
        {defender: line("damage", defender) for defender in defenders},
        {defender: line("ap50", defender) for defender in defenders},
        screened,
    )


def _common(lists: Sequence[Sequence[str]]) -> list[str]:
    """The items that all lists hold, in the order of the first."""
    return [item for item in lists[0] if all(item in other for other in lists)] if lists else []
