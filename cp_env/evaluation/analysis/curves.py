"""How the worst case moves along one axis, the others at their base: Δ, number of liars, fusion."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from cp_env.evaluation.analysis.worst_case import Scores, damages, extremes, mean_of, precisions
from cp_env.evaluation.plan.grid import Board, Played
from cp_env.metrics.intervals import Interval

AXES = {"fusion": "fusion", "budget": "Δ, the bound of ‖δ‖", "k": "k, lying vehicles"}
"""Axes in the order of `Board.point`, and how they are called in pictures: a symbol, and what it is."""


@dataclass(frozen=True)
class Curve:
    """Worst cases along an axis, over the attacks and scenes that all of its boards have in common."""

    axis: str  # of `AXES`
    values: tuple[str | float, ...]  # ascending, unless they are names
    attacks: tuple[str, ...]
    n_scenes: int
    damage: Mapping[str, tuple[Interval, ...]]  # a frame, by defender
    ap50: Mapping[str, tuple[Interval, ...]]

    @property
    def symbol(self) -> str:
        return AXES[self.axis].partition(",")[0]


def curves(boards: Sequence[tuple[Board, Played]]) -> list[Curve]:
    """One for every axis on which the boards, the base first, hold more than one value: k, Δ, fusion."""
    made = []
    for place, axis in reversed(list(enumerate(AXES))):
        base = boards[0][0].point
        arm = [(b, played) for b, played in boards if all(b.point[i] == base[i] for i in range(3) if i != place)]
        if len(arm) > 1:
            if axis != "fusion":
                arm = sorted(arm, key=lambda pair: pair[0].point[place])
            made.append(_curve(axis, tuple(board.point[place] for board, _ in arm), arm))
    return [curve for curve in made if curve is not None]


def _curve(axis: str, values: tuple[str | float, ...], arm: Sequence[tuple[Board, Played]]) -> Curve | None:
    damage, ap50 = ([figure(board, played) for board, played in arm] for figure in (damages, precisions))
    attacks = _common([[*by_attack] for table in damage for by_attack in table.values()])
    scenes = _common([[*scene] for table in damage for by in table.values() for scene in by.values()])
    defenders = _common([[*table] for table in damage])
    if not (attacks and scenes and defenders):
        return None

    def line(
        tables: Sequence[Scores], defender: str, choose: Callable[[Sequence[float]], float]
    ) -> tuple[Interval, ...]:
        cut = [{a: {s: table[defender][a][s] for s in scenes} for a in attacks} for table in tables]
        return tuple(mean_of(extremes(by_attack, choose)) for by_attack in cut)

    return Curve(
        axis,
        values,
        tuple(attacks),
        len(scenes),
        {defender: line(damage, defender, max) for defender in defenders},
        {defender: line(ap50, defender, min) for defender in defenders},
    )


def _common(lists: Sequence[Sequence[str]]) -> list[str]:
    """What all of them hold, in the order of the first."""
    return [item for item in lists[0] if all(item in other for other in lists)] if lists else []
