"""The measures of many worlds at once are those of each output by itself."""

from __future__ import annotations

import numpy as np
import pytest

from cp_env.metrics import critical, severity, targeted
from cp_env.metrics.driving import DrivingMeasures, of_clean
from cp_env.metrics.surroundings import Surroundings, frozen_scene
from cp_env.types import View
from tests.helpers.roads import boxes_at, driving, road, view_of

EXTENT = 32.0


def around(*places: tuple[float, float, float]) -> Surroundings:
    """An ego of 10 m/s at the origin, and vehicles at (x, y) with these speeds."""
    others = [driving(x - 0.2 * speed, y, speed, 3) for x, y, speed in places]
    return Surroundings.of(frozen_scene(road([driving(-2.0, 0, 10.0, 3), *others])), 1, 0, EXTENT)


def cases() -> tuple[list[np.ndarray], list[View], list[Surroundings]]:
    """Found, missed, with ghosts in the way and elsewhere, without vehicles, without boxes, and random ones."""
    traffic = [around((12, 0, 0), (20, 6, 5)), around((12, 0, 0)), around(), around((30, 0, 10)), around((8, 0, 9))]
    outputs = [boxes_at((12, 0), (20, 6)), boxes_at((9, 0)), boxes_at((15, 0)), np.zeros((0, 5)), boxes_at((8.5, 0.2))]
    clean = [boxes_at((12, 0)), boxes_at((12.5, 0)), np.zeros((0, 5)), boxes_at((30, 0)), boxes_at((6, 0), (-9, 0))]
    rng = np.random.default_rng(0)
    for _ in range(40):
        places = np.round(rng.uniform([-20, -6, 0], [30, 6, 12], (rng.integers(0, 6), 3)), 1)
        traffic.append(around(*map(tuple, places)))
        outputs.append(boxes_at(*rng.uniform([-20, -6], [30, 6], (rng.integers(0, 8), 2))))
        clean.append(boxes_at(*(places[:, :2] + rng.normal(0, 0.5, places[:, :2].shape))))
    return outputs, [view_of(boxes) for boxes in clean], traffic


def test_each_measure_is_that_of_the_output_by_itself() -> None:
    outputs, clean, traffic = cases()
    measures = DrivingMeasures(outputs, clean, traffic)
    for e, (boxes, view, mine) in enumerate(zip(outputs, clean, traffic, strict=True)):
        assert tuple(measures.critical[e]) == critical.critical_recall(boxes, mine)
        assert measures.miss_severity[e] == severity.miss_severity(boxes, mine).max(initial=0.0)
        assert measures.ghost_severity[e] == severity.ghost_severity(boxes, mine)
        assert measures.removable[e] == targeted.removable(view.seen.boxes, mine)
        assert measures.removed[e] == targeted.removed(boxes, view.seen.boxes, mine)
        assert measures.spoofed[e] == targeted.spoofed(boxes, view.seen.boxes, mine)
    for shown in (measures.removed, measures.spoofed, measures.removable):
        assert 0 < shown.sum() < len(shown), "both happen"
    assert measures.ghost_severity.any() and measures.miss_severity.any() and measures.critical.all(axis=1).any()


def test_a_missed_car_and_a_ghost_worked_by_hand() -> None:
    """The car that stands 12 m ahead has a gap of 8 m, the ghost 9 m ahead one of 5 m: 100 / (2 · 6), 100 / (2 · 3)
    at most 9."""
    measures = DrivingMeasures([boxes_at((9, 0))], [view_of(boxes_at((12, 0)))], [around((12, 0, 0))])
    assert measures.miss_severity == pytest.approx([100 / 12]) and measures.ghost_severity == pytest.approx([9.0])
    assert measures.critical.tolist() == [[0, 1]] and measures.removed.all() and measures.spoofed.all()


def test_what_is_asked_of_a_clean_view_is_remembered_for_its_traffic() -> None:
    view, mine, other = view_of(boxes_at((12, 0))), around((12, 0, 0)), around((30, 0, 0))
    assert of_clean(view, mine) is of_clean(view, mine) and of_clean(view, mine).removable
    assert not of_clean(view, other).removable and of_clean(view, other).critical_ghost


def test_its_arrays_are_read_only() -> None:
    measures = DrivingMeasures(*cases())
    for name in ("critical", "miss_severity", "ghost_severity", "removable", "removed", "spoofed"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(measures, name)[0] = 1


def test_no_world_is_no_number() -> None:
    measures = DrivingMeasures([], [], [])
    assert measures.critical.shape == (0, 2) and measures.removed.shape == measures.ghost_severity.shape == (0,)
