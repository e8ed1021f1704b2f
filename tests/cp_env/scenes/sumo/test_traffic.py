"""Tracks made of what the simulator tells."""

from __future__ import annotations

import numpy as np

from cp_env.scenes.sumo.traffic import AXLE, _tracks

SIZES = np.array([[4.0, 1.8, 1.5], [8.0, 2.4, 3.2]])


def test_a_front_bumper_heading_by_compass_becomes_a_box_centre() -> None:
    """SUMO: 90° is east. A 4 m car whose bumper is at (10, 5) has its centre at (8, 5)."""
    frames = [{"a": (10.0, 5.0, 90.0, "0"), "b": (0.0, 0.0, 180.0, "1")}]
    tracks = _tracks(frames, SIZES)
    assert np.allclose(tracks.pose[0, 0], [8, 5, 0])
    assert np.allclose(tracks.pose[0, 1], [0, 4, -np.pi / 2]), "southbound: the centre lies north of the bumper"
    assert np.allclose(tracks.size, SIZES)


def test_the_rear_axle_follows_the_bumper() -> None:
    """The bumper jumps 0.32 m sideways, as between lanes: the car turns by at most asin(0.32 / 3.2), not at once."""
    along = np.arange(10) * 1.0
    frames = [{"a": (x, 0.32 * (x > 4), 90.0, "0")} for x in along]
    yaw = _tracks(frames, SIZES).pose[:, 0, 2]
    assert np.allclose(yaw[:5], 0)
    assert np.isclose(yaw[5], np.arctan2(0.32, AXLE * 4 + 1))
    assert (np.diff(yaw[5:]) < 0).all() and yaw[-1] > 0, "and comes back straight"


def test_whoever_sumo_moves_elsewhere_at_once_goes_on_as_another() -> None:
    frames = [{"a": (x, 0.0, 90.0, "0")} for x in (0.0, 1.0, 50.0, 51.0)]
    pose = _tracks(frames, SIZES).pose
    assert pose.shape[1] == 2
    assert np.isfinite(pose[:2, 0]).all() and np.isnan(pose[2:, 0]).all()
    assert np.isnan(pose[:2, 1]).all() and np.isfinite(pose[2:, 1]).all()


def test_whoever_leaves_and_comes_back_is_another() -> None:
    frames: list[dict[str, tuple[float, float, float, str]]] = [{"a": (0.0, 0.0, 90.0, "0")}, {}]
    assert _tracks([*frames, frames[0]], SIZES).pose.shape[1] == 2
