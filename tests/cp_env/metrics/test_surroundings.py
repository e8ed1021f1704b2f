"""What is critical round the ego, worked by hand."""

from __future__ import annotations

import numpy as np
import pytest

from cp_env.metrics.ground_truth import truth_boxes
from cp_env.metrics.surroundings import Surroundings, frozen_scene, surroundings
from cp_env.scenes import open_source
from tests.helpers.roads import boxes_at, driving, road

EXTENT = 32.0


def around(*others: list[tuple[float, ...]], speed: float = 10.0) -> Surroundings:
    """The second of three frames of an ego at x = 0 there."""
    return Surroundings.of(road([driving(-0.2 * speed, 0, speed, 3), *others]), 1, 0, EXTENT)


def test_near_in_the_corridor_or_soon_to_be_hit_is_critical() -> None:
    """Gaps of 26 m at a closing speed of 10 m/s (2.6 s) and of 26 m at 5 m/s (5.2 s); 9 m ahead at the same speed; the
    next lane; a car behind."""
    seen = around(
        driving(30, 0, 0, 3),
        driving(29, 0, 5, 3),
        driving(11, 0, 10, 3),
        driving(11, 3.5, 10, 3),
        driving(-20, 0, 10, 3),
    )
    assert seen.critical.tolist() == [True, False, True, False, False]
    assert seen.gap[:3] == pytest.approx([26, 26, 9])
    assert seen.closing[:3] == pytest.approx([10, 5, 0])
    assert seen.deceleration == pytest.approx([100 / 48, 25 / 48, 0, 0, 0])


def test_the_nearest_is_the_first_in_the_corridor_else_the_nearest_at_all() -> None:
    abreast, ahead, far = driving(-2, 3.5, 10, 3), driving(13, 0, 10, 3), driving(13, 9, 10, 3)
    assert around(abreast, ahead).nearest == 1
    assert around(far, abreast).nearest == 1
    assert around().nearest is None


def test_boxes_taken_as_standing_demand_what_a_standing_car_would() -> None:
    ghost = np.array([[16.0, 0.0, 4.0, 2.0, 0.0]])
    assert around().standing(ghost).deceleration == pytest.approx([100 / (2 * (12 - 2))])
    assert around().standing(ghost[:0]).critical.shape == (0,)


def test_any_is_critical_where_one_is_by_its_gap_or_its_time() -> None:
    near, soon, crossing = boxes_at((9, 0)), boxes_at((26, 0)), boxes_at((0, 20))
    for boxes in (near, soon, crossing, np.concatenate([crossing, soon]), near[:0]):
        shown = around().standing(boxes)
        assert shown.any_critical == shown.critical.any()
    assert around().standing(soon).any_critical and not around().standing(crossing).any_critical


def test_targets_are_the_critical_and_the_nearest() -> None:
    seen = around(driving(20, 8, 10, 3), driving(11, 0, 10, 3), driving(30, 0, 0, 3))
    assert seen.targets.tolist() == [1, 2] and np.array_equal(seen.target_boxes, seen.boxes[1:])
    assert around(driving(20, 9, 10, 3)).targets.tolist() == [0], "the nearest, though it is not critical"
    assert around().targets.tolist() == []


def test_its_rows_are_those_of_the_ground_truth() -> None:
    scene = open_source("town/test").load("test-urban-01")
    ego = int(scene.connected[0])
    for frame in (0, 50, scene.n_frames - 1):
        seen = Surroundings.of(scene, frame, ego, EXTENT)
        assert np.array_equal(seen.boxes.astype(np.float32), truth_boxes(scene, frame, ego, EXTENT))
        assert ego not in seen.vehicle
        assert np.allclose(scene.pose[frame, seen.vehicle, :2] - seen.origin, seen.boxes[:, :2], atol=1e-4)


def test_nothing_of_it_can_be_written_and_it_is_remembered_for_its_scene() -> None:
    """What a plug-in is shown is shared by all outcomes of the frame."""
    scene = frozen_scene(road([driving(0, 0, 10, 3), driving(20, 0, 0, 3)]))
    assert frozen_scene(scene) is frozen_scene(scene)
    seen = surroundings(scene, 1, EXTENT)
    assert surroundings(scene, 1, EXTENT) is seen is not surroundings(scene, 0, EXTENT)
    computed = [seen.gap, seen.closing, seen.time_to_collision, seen.critical, seen.deceleration]
    for array in [*computed, seen.boxes, seen.velocity, seen.corridor.points, scene.pose, scene.size]:
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
