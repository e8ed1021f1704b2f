"""The ego's corridor on roads built by hand."""

from __future__ import annotations

import numpy as np
import pytest

from cp_env.metrics.corridor import REACH, Corridor, Path
from tests.helpers.roads import boxes_at, driving, road

ORIGIN = np.zeros(2)


def straight(speed: float, frames: int = 50) -> Corridor:
    scene = road([driving(0, 0, speed, frames)])
    return Corridor.recorded(scene, 0, 0, ORIGIN, speed)


def test_gaps_are_from_bumper_to_bumper_and_infinite_off_the_band() -> None:
    """Half lengths of 2 m each; the band reaches 1.1 m to each side, a box 1 m beyond its centre."""
    at = boxes_at((14, 0), (14, 2.05), (14, 2.15), (-14, 0), (3, 0), (-2.9, 0))
    assert straight(5.0).gaps(at)[0] == pytest.approx([10.0, 10.0, np.inf, np.inf, 0.0, np.inf])


def test_it_reaches_as_far_as_five_seconds_of_driving_and_at_least_thirty_metres() -> None:
    beyond = {0.0: 2 + REACH, 12.0: 60.0}
    for speed, reach in beyond.items():
        near, far = boxes_at((reach + 1.9, 0), (reach + 2.1, 0))
        assert np.isfinite(straight(speed).gaps(near[None])[0]).all()
        assert np.isinf(straight(speed).gaps(far[None])[0]).all()


def test_a_braking_ego_still_has_the_car_it_brakes_for_in_its_corridor() -> None:
    """It drives 10 m/s now and stands from the next frame on; 5 s at its speed of now are 50 m."""
    scene = road([[(0, 0, 0), *[(2, 0, 0)] * 40]])
    corridor = Corridor.recorded(scene, 0, 0, ORIGIN, 10.0)
    assert corridor.gaps(boxes_at((45, 0)))[0] == pytest.approx([41.0])


def test_the_corridor_bends_with_the_path_and_tells_its_direction() -> None:
    """East for 10 m, then north: a car 10 m up the second leg is 20 m along, less 4 m of half lengths."""
    east, north = [(x, 0, 0) for x in range(11)], [(10, y, np.pi / 2) for y in range(1, 31)]
    corridor = Corridor.recorded(road([[*east, *north]]), 0, 0, ORIGIN, 5.0)
    car = np.array([[10.0, 10.0, 4.0, 2.0, np.pi / 2], [20.0, 0.0, 4.0, 2.0, 0.0]])
    gap, heading = corridor.gaps(car)
    assert gap == pytest.approx([16.0, np.inf])
    assert heading[0] == pytest.approx([0.0, 1.0])


def test_a_long_vehicle_across_the_band_is_in_it_though_no_corner_is() -> None:
    lorry = np.array([[12.0, 0.5, 12.0, 2.5, np.pi / 2]])
    assert straight(5.0).gaps(lorry)[0] == pytest.approx([12 - 1.25 - 2])


def test_a_path_is_continued_straight_ahead_and_keeps_its_places() -> None:
    path = Path.recorded(road([driving(0, 0, 5, 11)]), 0, 0)
    assert path.place(0.0) == pytest.approx([0, 0, 0])
    assert path.place(7.5) == pytest.approx([7.5, 0, 0])
    assert path.place(30.0) == pytest.approx([30, 0, 0]), "10 m were recorded"


def test_a_standing_vehicle_has_a_path_ahead_of_it() -> None:
    path = Path.recorded(road([driving(3, 4, 0, 5, yaw=np.pi / 2)]), 0, 0)
    assert path.place(10.0) == pytest.approx([3, 14, np.pi / 2])


@pytest.mark.parametrize("n", [0, 3])
def test_boxes_far_away_have_no_gap(n: int) -> None:
    assert np.isinf(straight(5.0).gaps(boxes_at(*[(0.0, 50.0 + i) for i in range(n)]))[0]).sum() == n
