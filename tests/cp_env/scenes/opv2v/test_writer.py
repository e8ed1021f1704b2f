"""What is written as OPV2V comes back, to a millimetre, and says the same to whoever reads it by CARLA's rules."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from cp_env.scenes import Town
from cp_env.scenes.clip import Clip
from cp_env.scenes.export import export
from cp_env.scenes.formats import pcd
from cp_env.scenes.opv2v.source import OPV2V
from cp_env.scenes.opv2v.writer import write
from cp_env.types import Scene, SceneSource
from tests.helpers.toy_scenes import ToySource

MILLIMETRE = 1e-3


def require_same(source: SceneSource, name: str, back: SceneSource) -> None:
    """Rows come back in another order: the connected ones first; those that are never there do not come back."""
    scene, read = source.load(name), back.load(name)
    others = np.setdiff1d(np.arange(len(scene.size)), scene.connected)
    ever = others[np.isfinite(scene.pose[:, others, 0]).any(axis=0)]
    order = np.concatenate([scene.connected, ever])
    assert read.connected.tolist() == list(range(scene.n_connected)) and read.dt == pytest.approx(scene.dt)
    turn = (read.pose[..., 2] - scene.pose[:, order, 2] + np.pi) % (2 * np.pi) - np.pi
    shift = read.pose[..., :2] - scene.pose[:, order, :2]
    assert (np.isnan(read.pose) == np.isnan(scene.pose[:, order])).all()
    assert np.nanmax(np.abs(shift)) < MILLIMETRE and np.nanmax(np.abs(turn)) < 1e-5
    assert np.abs(read.size - scene.size[order]).max() < MILLIMETRE
    assert (read.rsu is None) == (scene.rsu is None)
    frames = range(scene.n_frames)
    for told, wanted in zip(back.sweeps(read, frames), source.sweeps(scene, frames), strict=True):
        for one, other in zip(told, wanted, strict=True):
            assert one.points.shape == other.points.shape and one.points.dtype == other.points.dtype
            assert np.abs(one.points - other.points).max() < MILLIMETRE
            assert np.abs(one.origin - other.origin).max() < MILLIMETRE
            assert one.hits is not None and other.hits is not None
            # boxes against rays: road that a ray met under a bumper, a sill below the clearance
            assert np.corrcoef(one.hits, other.hits[order])[0, 1] > 0.99


@pytest.mark.parametrize("data", pcd.ENCODINGS)
@pytest.mark.parametrize("rsu", [True, False])
def test_a_crossing_comes_back(data: str, rsu: bool, tmp_path: Path) -> None:
    source = ToySource(n_frames=2, n_connected=3, rsu=rsu)
    write(source, source.names(), tmp_path, data=data)
    back = OPV2V(tmp_path)
    assert back.names() == source.names()
    for name in source.names():
        require_same(source, name, back)


def test_a_recorded_scene_comes_back(tmp_path: Path) -> None:
    town = Clip(Town("test"), frames=2, vehicles=2)
    name = town.names()[1]
    export(town, tmp_path / "out", layout="opv2v", names=[name])
    require_same(town, name, OPV2V(tmp_path / "out"))


def test_another_reader_finds_the_same_points(tmp_path: Path) -> None:
    """By the rule of OpenCOOD: a left-handed matrix from (x, y, z, roll, yaw, pitch) takes points to CARLA's world."""
    source = ToySource(n_frames=1, n_connected=2)
    write(source, ["toy-1"], tmp_path)
    scene = source.load("toy-1")
    for agent, sweep in zip(("1001", "1002", "-1"), source.sweeps(scene, [0])[0], strict=True):
        said = yaml.safe_load((tmp_path / "toy-1" / agent / "000000.yaml").read_text())
        x, y, z, _, yaw, _ = said["lidar_pose"]
        c, s = np.cos(np.radians(yaw)), np.sin(np.radians(yaw))
        points = pcd.read(tmp_path / "toy-1" / agent / "000000.pcd")
        world = points @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T + [x, y, z]
        expected = sweep.points + np.append(sweep.origin[:2], 0.0)
        assert np.abs(world * [1, -1, 1] - expected).max() < MILLIMETRE
        assert set(said["vehicles"]) == set(range(1001, 1001 + len(scene.size)))
        assert all(type(value) is float for entry in said["vehicles"].values() for value in entry["location"])


def test_what_opv2v_cannot_say_is_refused(tmp_path: Path) -> None:
    class Slow(ToySource):
        def load(self, name: str) -> Scene:
            return replace(super().load(name), dt=0.03)

    with pytest.raises(ValueError, match=r"OPV2V numbers its frames by 0\.05 s; the frames .* are 0\.03 s apart"):
        write(Slow(n_frames=1), ["toy-0"], tmp_path)
    with pytest.raises(ValueError, match="unknown layout"):
        export(ToySource(n_frames=1), tmp_path / "x", layout="kitti")
