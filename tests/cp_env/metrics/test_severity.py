"""MDR and FSR on roads built by hand."""

from __future__ import annotations

import numpy as np
import pytest

from cp_env.metrics.severity import SeverityMeter, ghost_severity, miss_severity
from cp_env.metrics.surroundings import Surroundings
from cp_env.types import Scene
from tests.helpers.roads import boxes_at, driving, road

NOTHING = boxes_at()


def scene(speed: float = 10.0, gap: float = 30.0, frames: int = 6) -> Scene:
    """An ego that closes in on a standing car; `gap` metres between their bumpers in the first frame."""
    return road([driving(0, 0, speed, frames), driving(gap + 4, 0, 0, frames)])


def moved(boxes: np.ndarray, by: float) -> np.ndarray:
    """The boxes, so many metres farther along x."""
    return boxes + np.array([by, 0, 0, 0, 0])


def played(one: Scene, outputs: list[np.ndarray | None]) -> SeverityMeter:
    """The meter of an output a frame; None is the truth."""
    meter = SeverityMeter()
    for frame, boxes in enumerate(outputs):
        seen = Surroundings.of(one, frame, 0, 40.0)
        meter.add(seen.boxes if boxes is None else boxes, seen)
    return meter


def test_a_missed_car_demands_the_braking_of_its_gap_and_a_seen_one_none() -> None:
    seen = Surroundings.of(scene(), 1, 0, 40.0)  # 28 m are left
    assert miss_severity(NOTHING, seen) == pytest.approx([100 / 52])
    assert miss_severity(moved(seen.boxes, 1.9), seen).tolist() == [0.0], "a driver brakes for it all the same"
    assert miss_severity(moved(seen.boxes, 2.1), seen) == pytest.approx([100 / 52])


def test_mdr_needs_three_frames_of_the_same_car() -> None:
    """Gaps 30, 28, 26, … m. Two misses are none; three count with the hardest, the last: 100 / (2 · 24)."""
    assert played(scene(), [NOTHING, NOTHING, None, NOTHING, NOTHING]).mdr == 0.0
    assert played(scene(), [NOTHING, NOTHING, NOTHING, None]).mdr == pytest.approx(100 / (2 * (26 - 2)))


def test_two_cars_missed_in_turn_are_no_run() -> None:
    one = road([driving(0, 0, 10, 6), driving(30, 0, 0, 6), driving(38, 0, 0, 6)])
    seen = [Surroundings.of(one, frame, 0, 40.0).boxes for frame in range(4)]
    assert played(one, [seen[0][:1], seen[1][1:], seen[2][:1], seen[3][1:]]).mdr == 0.0
    assert played(one, [boxes[:1] for boxes in seen]).mdr > 0.0


def test_a_ghost_demands_the_braking_of_a_standing_car() -> None:
    seen = Surroundings.of(scene(), 0, 0, 40.0)
    assert ghost_severity(boxes_at((16, 0)), seen) == pytest.approx(100 / (2 * (12 - 2)))
    assert ghost_severity(boxes_at((16, 5)), seen) == 0.0
    assert ghost_severity(seen.boxes, seen) == 0.0


def test_fsr_of_a_ghost_that_keeps_its_distance_to_the_ego() -> None:
    """20 m before the bumper it demands 225 / 36 m/s² at 15 m/s, in each of 5 frames; it moves by 3 m a frame."""
    one = scene(speed=15, gap=90)
    egos = [float(Surroundings.of(one, frame, 0, 40.0).ego_box[0]) for frame in range(5)]
    assert played(one, [boxes_at((24 + ego, 0)) for ego in egos]).fsr == pytest.approx(60 * 225 / 36)


def test_ghosts_of_two_frames_cost_nothing_and_those_of_three_count_from_their_first() -> None:
    """A ghost that stands at x = 30, at 15 m/s: gaps 26, 23, 20 m, 0.2 s each of 1 s."""
    far = scene(speed=15, gap=90)
    at = [boxes_at((30 - float(Surroundings.of(far, frame, 0, 40.0).origin[0]), 0)) for frame in range(3)]
    assert played(far, [at[0], at[1], None, None, None]).fsr == 0.0
    lost = 0.2 * 225 / 2 * (1 / 24 + 1 / 21 + 1 / 18)
    assert played(far, [*at, NOTHING, NOTHING]).fsr == pytest.approx(60 * lost)


def test_ghosts_at_three_places_are_no_persistent_one() -> None:
    places = [boxes_at((x, 0)) for x in (14, 22, 30)]
    assert played(scene(gap=60), places).fsr == 0.0


def test_an_episode_without_frames_has_lost_nothing() -> None:
    assert (SeverityMeter().mdr, SeverityMeter().fsr) == (0.0, 0.0)
