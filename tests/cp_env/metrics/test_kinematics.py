"""Velocities, time to collision and required deceleration, worked by hand."""

from __future__ import annotations

import numpy as np
import pytest

from cp_env.metrics.kinematics import required_deceleration, time_to_collision, velocities
from tests.helpers.roads import boxes_at, driving, road

EGO = np.array([0.0, 0.0, 4.0, 2.0, 0.0])


def test_velocities_are_central_differences_and_one_sided_at_the_ends() -> None:
    scene = road([[(0, 0, 0), (1, 0, 0), (3, 0, 0)], [(0, 0, 0), (0, 2, 0), (0, 4, 0)]], dt=0.5)
    assert velocities(scene, 0).tolist() == [[2, 0], [0, 4]]
    assert velocities(scene, 1).tolist() == [[3, 0], [0, 4]]  # (3 - 0) / (2 * 0.5)
    assert velocities(scene, 2).tolist() == [[4, 0], [0, 4]]


def test_an_absent_neighbour_leaves_a_one_sided_difference_and_none_leaves_rest() -> None:
    nothing = (np.nan, np.nan, np.nan)
    scene = road([driving(0, 0, 5, 3), [nothing, (1, 0, 0), (2, 0, 0)], [nothing, (7, 7, 0), nothing]], dt=0.2)
    assert velocities(scene, 1)[1:].tolist() == [[5, 0], [0, 0]]


def test_time_to_collision_on_one_line_is_gap_over_closing_speed() -> None:
    """Bumper to bumper 20 - 4 = 16 m; the discs' ends coincide with the bumpers."""
    time = time_to_collision(boxes_at((20, 0)), np.array([[2.0, 0.0]]), EGO, np.array([10.0, 0.0]))
    assert time == pytest.approx([16 / 8])


def test_time_to_collision_of_the_next_lane_of_one_that_leaves_and_of_one_that_touches() -> None:
    at = boxes_at((20, 3.5), (20, 0), (-20, 0), (3, 0))
    moving = np.array([[0.0, 0.0], [11.0, 0.0], [0.0, 0.0], [10.0, 0.0]])
    assert time_to_collision(at, moving, EGO, np.array([10.0, 0.0])).tolist() == [np.inf, np.inf, np.inf, 0.0]


def test_time_to_collision_of_a_crossing_vehicle() -> None:
    """It comes from the right at 5 m/s and meets the ego's flank: 10 m less half a length and half a width."""
    crossing = np.array([[0.0, -10.0, 4.0, 2.0, np.pi / 2]])
    assert time_to_collision(crossing, np.array([[0.0, 5.0]]), EGO, np.zeros(2)) == pytest.approx([(10 - 2 - 1) / 5])


def test_no_vehicles_have_no_times() -> None:
    assert time_to_collision(np.zeros((0, 5)), np.zeros((0, 2)), EGO, np.zeros(2)).shape == (0,)


def test_required_deceleration_by_hand() -> None:
    """10 m/s in 12 - 2 m: 100 / 20. Nobody closing in demands nothing, and no car brakes harder than 9 m/s²."""
    closing, gap = np.array([10.0, -3.0, 10.0, 3.0, 10.0]), np.array([12.0, 5.0, 1.0, 2.0, np.inf])
    assert required_deceleration(closing, gap).tolist() == [5.0, 0.0, 9.0, 9.0, 0.0]
