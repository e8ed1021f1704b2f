"""CARLA's axes by hand, there and back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cp_env.scenes.opv2v.axes import carla_motion, from_carla, mirrored, planar, to_carla

ANGLE = st.floats(-180, 180)


def at(pose: list[float], point: list[float]) -> list[float]:
    """Our world's coordinates of a point of a body as a file of CARLA's stores it."""
    found = from_carla(np.array(pose, dtype=float)) @ [*mirrored(np.array(point, dtype=float)), 1.0]
    return [float(x) for x in np.round(found, 9) + 0.0]


def test_axes_by_hand() -> None:
    """A sensor 2 m above CARLA's (10, 20): to us it stands at (10, -20); its right is south when it looks east."""
    east = [10, 20, 2, 0, 0, 0]
    assert at(east, [1, 0, 0]) == [11, -20, 2], "ahead"
    assert at(east, [0, 1, 0]) == [10, -21, 2], "to its right"
    assert at(east, [0, 0, 1]) == [10, -20, 3], "up"
    right_about = [10, 20, 2, 0, 90, 0]
    assert at(right_about, [1, 0, 0]) == [10, -21, 2], "a yaw of 90° turns right, to the south"
    assert at(right_about, [0, 1, 0]) == [9, -20, 2], "its right is then west"
    assert at([0, 0, 0, 0, 0, 90], [1, 0, 0]) == [0, 0, 1], "a positive pitch lifts the nose"
    assert at([0, 0, 0, 90, 0, 0], [0, 1, 0]) == [0, 0, -1], "a positive roll lowers the right side"
    assert planar(from_carla(np.array(right_about, dtype=float)))[2] == pytest.approx(-np.pi / 2)


@given(ANGLE, ANGLE, ANGLE)
def test_both_frames_are_rigid_and_the_turns_come_in_carlas_order(roll: float, yaw: float, pitch: float) -> None:
    """A body is rolled, then pitched, then turned; the mirror makes neither a reflection nor another length."""
    pose = np.array([1.0, 2.0, 3.0, roll, yaw, pitch])
    step = [carla_motion(np.array([0, 0, 0, *turn])) for turn in ((roll, 0, 0), (0, 0, pitch), (0, yaw, 0))]
    assert np.allclose(carla_motion(pose)[:, :3], step[2][:, :3] @ step[1][:, :3] @ step[0][:, :3])
    for motion in (carla_motion(pose), from_carla(pose)):
        assert np.allclose(motion[:, :3] @ motion[:, :3].T, np.eye(3))
        assert np.linalg.det(motion[:, :3]) == pytest.approx(1)


@given(st.floats(-500, 500), st.floats(-500, 500), st.floats(0, 9), st.floats(-3, 3))
def test_our_pose_goes_to_carla_and_back(x: float, y: float, z: float, yaw: float) -> None:
    motion = from_carla(np.array(to_carla(x, y, z, yaw)))
    assert np.allclose(motion[:, 3], [x, y, z])
    assert planar(motion)[2] == pytest.approx(yaw)
