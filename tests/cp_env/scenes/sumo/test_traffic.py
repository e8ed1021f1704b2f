"""Tracks made of what the simulator tells."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from cp_env.scenes.sumo.traffic import AXLE, _tracks, stretches, watch
from tests.helpers.sumo_networks import configuration, netgenerate

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


@pytest.fixture
def command(tmp_path: Path) -> list[str]:
    """Cars for a minute through a grid, and a bicycle."""
    net = netgenerate(tmp_path / "g.net.xml", "--grid", "--grid.number", "2", "--grid.length", "100")
    routes = (
        '<vType id="bike" vClass="bicycle"/><trip id="b" type="bike" depart="0" from="A0A1" to="B1B0"/>'
        '<flow id="f" from="A0A1" to="B1B0" begin="0" end="60" period="5"/>'
    )
    return ["-c", str(configuration(net, routes)), "--seed", "1"]


def test_stretches_follow_each_other_until_nothing_drives(command: list[str]) -> None:
    """Four of 10 s are one of 40 s; and all of it ends when the last car has left, long before the hour asked for."""
    with closing(stretches(command, warm_up=5.0, seconds=10.0, most=40.0)) as found:
        parts = list(found)
    whole = watch(command, warm_up=5.0, seconds=40.0)
    assert [len(part.pose) for part in parts] == [50] * 4 and len(whole.pose) == 200
    assert whole.left_out == {"bicycle"} == parts[0].left_out
    crowd = np.concatenate([np.isfinite(part.pose[..., 0]).sum(axis=1) for part in parts])
    assert np.array_equal(crowd, np.isfinite(whole.pose[..., 0]).sum(axis=1)) and crowd.max() > 3
    with closing(stretches(command, warm_up=0.0, seconds=20.0, most=3600.0)) as found:
        assert 3 < len(list(found)) < 20


def test_a_generator_closed_early_leaves_room_for_the_next_simulation(command: list[str]) -> None:
    for _ in range(2):
        with closing(stretches(command, warm_up=0.0, seconds=4.0, most=400.0)) as found:
            next(found)
    assert len(watch(command, warm_up=0.0, seconds=4.0).pose) == 20
