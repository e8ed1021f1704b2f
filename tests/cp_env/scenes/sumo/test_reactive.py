"""Traffic that reacts: it repeats the recording where the ego does, and gives way where it does not."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from cp_env.metrics.kinematics import velocities
from cp_env.scenes.sumo.live import LiveSumo
from cp_env.scenes.sumo.reactive import UNVEILED, Stage, open_stage
from cp_env.scenes.sumo.traffic import DT
from cp_env.types import Scene, SceneSource
from tests.helpers.sumo_networks import configuration, netgenerate

pytestmark = pytest.mark.usefixtures("simulator")

NAME = "suburban-000000"
NEAR = 60.0
"""Within so far of the ego traffic is compared; both scenes hold everyone there. m."""


@pytest.fixture(scope="module")
def stage() -> Iterator[Stage]:
    pytest.importorskip("libsumo", reason="needs the extra sumo")
    with open_stage(LiveSumo("suburban", warm_up=40.0), NAME) as stage:
        yield stage


@pytest.fixture(scope="module")
def recorded(stage: Stage) -> Scene:
    return stage.source.load(NAME)


def test_an_ego_that_drives_as_recorded_gives_the_recorded_traffic(stage: Stage, recorded: Scene) -> None:
    """SUMO maps a vehicle that is put somewhere to its lane anew, and tells others its speed a little differently."""
    ego, far = int(recorded.connected[0]), 0.0
    with stage.traffic(frames=40) as traffic:
        assert np.allclose(traffic.scene.pose[0, 0], recorded.pose[0, ego])
        assert np.allclose(traffic.scene.size[0], recorded.size[ego])
        for frame in range(1, 40):
            place = recorded.pose[frame, ego]
            traffic.step(place, float(np.linalg.norm(place[:2] - recorded.pose[frame - 1, ego, :2])) / DT)
            there = recorded.pose[frame][np.linalg.norm(recorded.pose[frame, :, :2] - place[:2], axis=1) < NEAR]
            now = traffic.scene.pose[frame][np.isfinite(traffic.scene.pose[frame, :, 0])]
            apart = np.linalg.norm(there[:, None, :2] - now[None, :, :2], axis=-1).min(axis=1)
            far = max(far, float(apart.max()))
        assert np.allclose(traffic.scene.pose[:40, 1], recorded.pose[:40, recorded.connected[1]], atol=0.5)
    assert far < 0.5


def test_those_behind_stop_behind_an_ego_that_stops(tmp_path: Path) -> None:
    """A car every three seconds on one way round a block. The ego stops at once where it is, for twelve seconds."""
    net = netgenerate(tmp_path / "g.net.xml", "--grid", "--grid.number", "2", "--grid.length", "200")
    flow = '<flow id="f" from="A0A1" to="B1B0" begin="0" end="3600" period="3"/>'
    line = LiveSumo(configuration(net, flow), furnish="none", vehicles=2, warm_up=30.0)
    with open_stage(line, line.names()[0]) as lane, lane.traffic(frames=60, connected=2) as traffic:
        place = traffic.path.place(0.0)
        for _ in range(59):
            traffic.step(place, 0.0)
        assert traffic.ended
        pose, size, speed = traffic.scene.pose[59], traffic.scene.size, velocities(traffic.scene, 59)
    heading = np.array([np.cos(place[2]), np.sin(place[2])])
    gap = (place[:2] - pose[:, :2]) @ heading - (size[:, 0] + size[0, 0]) / 2
    lane = np.abs((pose[:, :2] - place[:2]) @ [-heading[1], heading[0]]) < 1.0
    queue = np.sort(gap[lane & (gap > -size[0, 0]) & (gap < 40)])
    assert len(queue) >= 2 and 0.5 < queue[0] < 4
    assert (np.linalg.norm(speed[lane & (gap > 0) & (gap < 10)], axis=1) < 0.1).all()


def test_the_scene_grows_and_keeps_its_rows(stage: Stage, recorded: Scene) -> None:
    with stage.traffic(frames=30, connected=3) as traffic:
        before = traffic.scene
        for _ in range(10):
            traffic.step(traffic.path.place(DT * 4.0 * (traffic.frame + 1)), 4.0)
            after = traffic.scene
            known = before.pose.shape[1]
            past = slice(traffic.frame)
            assert np.array_equal(after.pose[past, :known], before.pose[past], equal_nan=True)
            assert np.array_equal(after.size[:known], before.size)
            before = after
        assert isinstance(traffic, SceneSource) and traffic.load(traffic.names()[0]) is after
        assert after.n_frames == 30 and after.connected.tolist() == [0, 1, 2]
        assert np.isfinite(after.pose[:, :3]).all()
        moving = velocities(after, traffic.frame)
        last = (after.pose[10, :, :2] - after.pose[9, :, :2]) / DT
        seen = np.isfinite(last[:, 0])
        assert np.allclose(moving[seen][1:], last[seen][1:], atol=1e-6), "a velocity is that of the past"
        assert np.linalg.norm(moving[0]) == pytest.approx(4.0, abs=0.1)
        assert np.linalg.norm(after.pose[12, 0, :2] - after.pose[11, 0, :2]) == pytest.approx(UNVEILED * DT, abs=0.05)
        sweeps = traffic.sweeps(after, [10])[0]
        assert len(sweeps) == 3 + (after.rsu is not None)
        assert np.allclose(sweeps[0].origin[:2], after.pose[10, 0, :2])
        with pytest.raises(ValueError, match="unknown scene 'x'"):
            traffic.load("x")


def test_the_same_drive_twice_is_the_same(stage: Stage) -> None:
    poses = []
    for _ in range(2):
        with stage.traffic(frames=8) as traffic:
            for _ in range(7):
                traffic.step(traffic.path.place(0.5 * (traffic.frame + 1)), 2.5)
            poses.append(traffic.scene.pose)
    assert np.array_equal(poses[0], poses[1], equal_nan=True)


def test_more_connected_vehicles_than_there_are(stage: Stage) -> None:
    with (
        pytest.raises(ValueError, match=r"connected vehicles: ask for 1 to \d, not 50"),
        stage.traffic(connected=50),
    ):
        pass
