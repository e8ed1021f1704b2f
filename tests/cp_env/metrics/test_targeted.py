"""Success of targeted attacks, worked by hand."""

from __future__ import annotations

from cp_env.metrics.surroundings import Surroundings
from cp_env.metrics.targeted import longest_streak, removable, removed, spoofed
from tests.helpers.roads import boxes_at, driving, road

AHEAD, ABREAST = (14.0, 0.0), (5.0, 8.0)
BOTH = boxes_at(AHEAD, ABREAST)


def around() -> Surroundings:
    """A standing ego, a car ahead (the target, as it is in the corridor) and a nearer one abreast."""
    return Surroundings.of(road([driving(*place, 0, 3) for place in ((0.0, 0.0), AHEAD, ABREAST)]), 1, 0, 32.0)


def test_the_car_ahead_is_the_target() -> None:
    assert removed(boxes_at(ABREAST), BOTH, around())
    assert not removed(boxes_at(AHEAD), BOTH, around())


def test_what_the_detector_misses_by_itself_is_no_success() -> None:
    assert not removed(boxes_at(), boxes_at(ABREAST), around())
    assert not removable(boxes_at(ABREAST), around()) and removable(BOTH, around())
    nobody = Surroundings.of(road([driving(0, 0, 0, 3)]), 1, 0, 32.0)
    assert not removable(BOTH, nobody) and not removed(boxes_at(), BOTH, nobody)


def test_a_ghost_counts_where_a_standing_car_would_be_critical() -> None:
    ghost, far = (9.0, 0.0), (9.0, 20.0)
    assert spoofed(boxes_at(AHEAD, ABREAST, ghost), BOTH, around())
    assert not spoofed(boxes_at(AHEAD, ABREAST, far), BOTH, around())
    assert not spoofed(boxes_at(AHEAD, ABREAST, ghost), boxes_at(ghost), around()), "it is there without an attack"
    assert not spoofed(boxes_at((12.5, 0.0)), BOTH, around()), "a displaced car is no ghost"


def test_the_longest_streak() -> None:
    assert longest_streak([]) == 0
    assert longest_streak([0, 1, 1, 0, 1, 1, 1, 0]) == 3
    assert longest_streak([True, True]) == 2
