"""Measures by which entries are compared: what an episode is worth, which way is better, and which interval it has.

A ranking takes any of them by name. Another measure is one more line in `MEASURES`: it then is a column of all tables
of rows, a field of their JSON and of the arena's, and can rank.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Literal

import numpy as np

from cp_env.evaluation.plan.records import IOUS, PooledApMeter, Record
from cp_env.metrics.intervals import Interval, rate_interval, t_interval
from cp_env.metrics.shares import share_interval

Kind = Literal["share", "rate", "count"]
"""In [0, 1]; whether something happened in an episode, 0 or 1; or any number from 0 on."""

Value = Callable[[Sequence[Record], int], "float | None"]
"""The value of a scene's episodes, given how many frames each was to have; None where it has no meaning."""


@dataclass(frozen=True)
class Measure:
    """A value of an episode by which defenders and attacks are compared."""

    name: str  # in options, and of the field in JSON
    heading: str  # of its column
    of_scene: Value  # of some episodes of a scene: of all its seeds, or of one
    lower_is_better: bool = False  # for the defender
    kind: Kind = "share"
    spec: str = ".3f"  # how it is printed
    headline: bool = False  # whether every ranking shows it, and a pairwise table of its own
    column: bool = True  # whether the tables of rows show it; those that other columns or tables have do not ask
    caption: str = ""  # of its pairwise table

    def worst(self, values: Sequence[float]) -> float:
        """The value that is worst for the defender."""
        return max(values) if self.lower_is_better else min(values)

    def best(self, values: Sequence[float]) -> float:
        """The value that is best for the defender."""
        return min(values) if self.lower_is_better else max(values)

    def loss(self, value: float) -> float:
        """How much of what a defender could keep is lost, in [0, 1]; 0 for a count, which has no upper end."""
        if self.kind == "count":
            return 0.0
        return value if self.lower_is_better else 1 - value

    def interval_of(self, values: Sequence[float]) -> Interval:
        """Mean over scenes: a count's with Student's interval, others with Gaffke's."""
        return t_interval(values, least=0.0) if self.kind == "count" else share_interval(values)

    def summary(self, scenes: Iterable[Sequence[Record]], frames: int) -> Interval | None:
        """The value over scenes, or of a rate over their episodes, with its interval; None where it has no meaning."""
        if self.kind == "rate":
            found = [self.of_scene([record], frames) for scene in scenes for record in scene]
            known = [bool(value) for value in found if value is not None]
            return rate_interval(sum(known), len(known)) if known else None
        values = [value for scene in scenes if (value := self.of_scene(scene, frames)) is not None]
        return self.interval_of(values) if values else None


def episode_mean(value: Callable[[Record], float | None]) -> Value:
    """The mean over a scene's episodes of a value of each; episodes where it is None are left out."""

    def of_scene(records: Sequence[Record], frames: int) -> float | None:
        del frames
        values = [found for record in records if (found := value(record)) is not None]
        return float(np.mean(values)) if values else None

    return of_scene


def critical_recall(records: Sequence[Record], frames: int) -> float | None:
    """Mean over episodes of the critical recall; None if no vehicle was critical in any, or none was recorded.

    In frames that a failing defender never saw nothing was found: its recall counts for the frames that it saw.
    """
    values = []
    for record in records:
        found = None if record.driving is None else record.driving.recall(record.grace_frames)
        if found is not None:
            values.append(found * (len(record.damage) / frames if record.error is not None else 1.0))
    return float(np.mean(values)) if values else None


def damage_per_frame(record: Record, frames: int) -> float:
    """Mean damage over the frames in which an attack could act.

    Frames that a failing defender never saw count as 1.
    """
    acted = list(record.damage[record.grace_frames :])
    if record.error is not None:
        acted += [1.0] * (frames - len(record.damage))
    return float(np.mean(acted or record.damage))


MEASURES: dict[str, Measure] = {
    measure.name: measure
    for measure in (
        Measure(
            "damage",
            "detection loss/frame",
            lambda records, frames: float(np.mean([damage_per_frame(record, frames) for record in records])),
            lower_is_better=True,
            headline=True,
            column=False,
            caption="Detection loss/frame, mean over scenes.",
        ),
        Measure(
            "ap50",
            "AP@.5",
            lambda records, frames: PooledApMeter.pool([record.meter for record in records]).value(IOUS[0]),
            headline=True,
            column=False,
            caption="AP@0.5 of a scene, mean over scenes.",
        ),
        Measure(
            "critical_recall",
            "critical recall",
            critical_recall,
            headline=True,
            column=False,
            caption="Critical recall, mean over scenes: of the vehicles that were critical, the share that was found.",
        ),
    )
}
"""By name. The first one ranks unless another is named."""


def measure_of(name: str) -> Measure:
    """The measure of that name. ValueError for a name that is not known."""
    if name not in MEASURES:
        near = get_close_matches(name, MEASURES, 1)
        hint = f" (did you mean {near[0]!r}?)" if near else ""
        raise ValueError(f"unknown measure {name!r}{hint}: choose one of {', '.join(MEASURES)}")
    return MEASURES[name]


def headlines() -> list[str]:
    """The names of the measures that every ranking shows."""
    return [name for name, measure in MEASURES.items() if measure.headline]
