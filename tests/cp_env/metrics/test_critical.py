"""Critical recall and critical AP, worked by hand."""

from __future__ import annotations

import numpy as np
import pytest

from cp_env.metrics.average_precision import ApMeter
from cp_env.metrics.critical import CriticalApMeter, critical_recall, found
from cp_env.metrics.surroundings import Surroundings
from cp_env.types import Detections
from tests.helpers.roads import boxes_at, driving, road

AHEAD, ABREAST, BEHIND = (9.0, 0.0), (12.0, 8.0), (-20.0, 8.0)


def around() -> Surroundings:
    """A standing ego; one car 5 m before its bumper is critical, two others are not."""
    return Surroundings.of(road([driving(*place, 0, 3) for place in ((0.0, 0.0), AHEAD, ABREAST, BEHIND)]), 1, 0, 32.0)


def ap(*places: tuple[float, float]) -> float:
    """Critical AP of boxes there, best first."""
    meter = CriticalApMeter()
    boxes = boxes_at(*places)
    meter.add_critical(Detections(boxes, np.linspace(0.9, 0.1, len(boxes))), around())
    return meter.value(0.5)


def test_a_vehicle_is_found_by_an_overlap_of_half() -> None:
    """Two boxes of 4 m that are moved by x overlap by (4 - x) / (4 + x): half at 4/3 m."""
    truth = boxes_at((0, 0))
    assert found(boxes_at((1.33, 0)), truth).tolist() == [True]
    assert found(boxes_at((1.34, 0)), truth).tolist() == [False]
    assert found(boxes_at(), truth).tolist() == [False]


def test_recall_counts_the_critical_vehicle_alone() -> None:
    assert critical_recall(boxes_at(AHEAD), around()) == (1, 1)
    assert critical_recall(boxes_at(ABREAST, BEHIND), around()) == (0, 1)


def test_others_are_neither_missed_nor_false() -> None:
    assert ap(AHEAD) == 1.0, "two cars that are not critical are missed"
    assert ap(ABREAST, BEHIND, AHEAD) == 1.0, "found with higher scores, they cost no precision"
    assert ap(ABREAST, BEHIND) == 0.0


def test_a_ghost_costs_precision_where_a_standing_car_would_be_critical() -> None:
    """A ghost 6 m ahead of the bumper with the highest score halves the precision; one far away does nothing."""
    assert ap((-9.0, 20.0), AHEAD) == 1.0
    assert ap((11.9, 0.0), AHEAD) == pytest.approx(0.5)
    assert ap(AHEAD, (11.9, 0.0)) == 1.0


def test_where_all_are_critical_it_is_the_strict_ap() -> None:
    """A slow convoy: each of four cars is within 10 m of the bumper or is hit within 4 s."""
    tracks = [driving(0, 0, 10, 3), *[driving(12 + 5 * i, 0, 0, 3) for i in range(4)]]
    seen = Surroundings.of(road(tracks), 1, 0, 32.0)
    assert seen.critical.all()
    rng = np.random.default_rng(0)
    strict, critical = ApMeter([0.5]), CriticalApMeter()
    for _ in range(20):
        boxes = np.concatenate([seen.boxes, boxes_at((17.5, 0.3))]) + rng.normal(0, 0.5, (5, 5)) * [1, 0.3, 0, 0, 0]
        found_now = Detections(boxes, rng.random(5))
        strict.add(found_now, seen.boxes)
        critical.add_critical(found_now, seen)
    assert 0.1 < strict.value(0.5) < 0.9
    assert critical.value(0.5) == strict.value(0.5)
