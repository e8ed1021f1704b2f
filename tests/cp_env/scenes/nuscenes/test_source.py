"""nuScenes: a street by hand, sweeps between keyframes, what is written comes back, laws, refusals, damage."""

from __future__ import annotations

import json
import pickle
import random
import shutil
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

import cp_env
from cp_env.detector.training.data import prepare
from cp_env.scenes import open_source
from cp_env.scenes.errors import BrokenData
from cp_env.scenes.nuscenes.source import NuScenes
from cp_env.scenes.v2xsim.source import V2XSim
from cp_env.testing import check_scenes
from cp_env.types import SceneSource
from tests.helpers.damage import damaged
from tests.helpers.nuscenes_sets import VERSION, by_hand, write_set
from tests.helpers.toy_scenes import ToySource

TOY = ToySource(n_frames=3, n_connected=1)
NAMES = ("scene-0061", "scene-0103")


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_set(TOY, tmp_path_factory.mktemp("nuscenes"), NAMES)


@pytest.fixture(scope="module")
def thin(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_set(TOY, tmp_path_factory.mktemp("nuscenes"), NAMES, every=200)


def test_a_street_by_hand(tmp_path: Path) -> None:
    """See the drawing in `by_hand`: the bus is at (-15, 20) from the ego, and returns once from (-14, 16)."""
    source = open_source(f"nuscenes:{by_hand(tmp_path)}?progress=no")
    assert isinstance(source, NuScenes) and isinstance(source, SceneSource) and source.names() == ("scene-0061",)
    scene = source.load("scene-0061")
    assert scene.dt == pytest.approx(0.5) and scene.n_frames == 2 and scene.rsu is None
    assert scene.connected.tolist() == [1] and source.classes(scene) == ("vehicle.bus.rigid", "not annotated")
    assert_allclose(scene.pose[:, 0], [[-5, 70, np.pi / 2]] * 2, atol=1e-6)
    assert_allclose(scene.pose[:, 1], [[10, 50, np.pi / 2], [10, 55, np.pi / 2]], atol=1e-6)
    assert_allclose(scene.size, [[10, 3, 3], [4.084, 1.73, 1.562]])
    for k, (sweep,) in enumerate(source.sweeps(scene, [0, 1])):
        assert_allclose(sweep.origin, [10, 50 + 5 * k, 1.84], atol=1e-6)
        assert_allclose(sweep.points, [[-14, 16 - 5 * k, 1], [2, 10 - 5 * k, 0]], atol=1e-5)
        assert sweep.hits is not None and sweep.hits.tolist() == [1, 0], "its own roof is left out"
    everyone = NuScenes(tmp_path, categories=("vehicle", "human"), progress=False)
    assert len(everyone.load("scene-0061").size) == 3 and everyone.digest != source.digest


def test_a_frame_of_several_sweeps_by_hand(tmp_path: Path) -> None:
    """The sweep between shows the kerb at (13, 53) and the ego's own roof where it was then, which is left out."""
    by_hand(tmp_path)
    for sweeps, more in ((1, 0), (2, 1), (3, 3)):
        source = NuScenes(tmp_path, sweeps=sweeps, progress=False)
        first, second = (frame[0] for frame in source.sweeps(source.load("scene-0061"), [0, 1]))
        assert len(first.points) == 2 and len(second.points) == 2 + more, sweeps
        assert_allclose(second.points[:2], [[-14, 11, 1], [2, 5, 0]], atol=1e-5)
    assert_allclose(second.points[2:], [[-14, 11, 1], [2, 5, 0], [3, -2, 0.1]], atol=1e-5)
    assert second.hits is not None and second.hits.tolist() == [2, 0]
    with pytest.raises(ValueError, match="sweeps must be from 1 to 50, not 0"):
        NuScenes(tmp_path, sweeps=0)


@pytest.mark.parametrize("sweeps", [1, 10])
def test_what_is_written_keeps_the_laws(tmp_path: Path, written: Path, sweeps: int) -> None:
    root = written if sweeps == 1 else write_set(ToySource(n_frames=5, n_connected=1), tmp_path, NAMES, between=1)
    skip = () if sweeps == 1 else ("boxes_hold_their_vehicles", "returns_lie_in_their_box")  # what moves is smeared
    assert len(check_scenes(NuScenes(root, sweeps=sweeps, progress=False), skip=skip)) > 15


def test_what_is_written_comes_back(written: Path) -> None:
    source = NuScenes(written, progress=False)
    for name, toy in zip(NAMES, TOY.names(), strict=True):
        scene, truth = source.load(name), TOY.load(toy)
        order = [row for row in range(len(truth.size)) if row != truth.connected[0]]
        others = np.setdiff1d(np.arange(len(scene.size)), scene.connected)
        assert_allclose(scene.pose[:, others, :2], truth.pose[:, order, :2], atol=1e-6)
        assert_allclose(np.sin((scene.pose[:, others, 2] - truth.pose[:, order, 2]) / 2), 0, atol=1e-6)
        assert_allclose(scene.size[others], truth.size[order], atol=1e-6)
        assert_allclose(scene.pose[:, scene.connected[0], :2], truth.pose[:, truth.connected[0], :2], atol=1e-6)
        for (sweep,), (wanted, *_) in zip(source.sweeps(scene, range(3)), TOY.sweeps(truth, range(3)), strict=True):
            far = np.hypot(*wanted.points[:, :2].T) > 3
            told = np.hypot(*sweep.points[:, :2].T) > 3
            assert_allclose(sweep.points[told], wanted.points[far], atol=1e-3)


def test_sensors_axes_and_egos_heading_are_not_mixed_up(written: Path) -> None:
    """LIDAR_TOP looks to the right: a heading taken from it would be wrong by 90°."""
    scene = NuScenes(written, progress=False).load("scene-0061")
    step = np.diff(scene.pose[:, scene.connected[0]], axis=0)
    assert_allclose(np.arctan2(step[:, 1], step[:, 0]), scene.pose[:-1, scene.connected[0], 2], atol=1e-6)


def test_splits_versions_and_scenes(written: Path) -> None:
    assert NuScenes(written, split="mini_val", progress=False).names() == ("scene-0103",)
    assert open_source(f"nuscenes:{written}?version={VERSION}&split=mini_train&progress=no").names() == ("scene-0061",)
    assert NuScenes(written, scenes=("103",), progress=False).names() == ("scene-0103",)
    with pytest.raises(BrokenData, match=r"v1\.0-trainval"):
        NuScenes(written, version="v1.0-trainval")


def test_one_vehicle_is_no_fleet(thin: Path) -> None:
    with pytest.raises(ValueError, match="recorded by one vehicle: vehicles must be 1, not 2; sources with more are"):
        open_source(f"nuscenes:{thin}?vehicles=2")
    with pytest.raises(ValueError, match="holds only 1 connected vehicle; choose other scenes"):
        cp_env.parallel_env("ego_only", scenes=f"nuscenes:{thin}?progress=no", n_vehicles=2, n_attackers=1)


def test_detectors_are_trained_on_it(written: Path, tmp_path: Path) -> None:
    grids = prepare(NuScenes(written, progress=False), tmp_path, limit=1)
    assert grids[0].hits.sum() > 0


def test_v2x_sim_and_nuscenes_are_told_apart(written: Path, tmp_path: Path) -> None:
    with pytest.raises(BrokenData, match=r"no channel LIDAR_TOP_id_k: these are no tables of V2X-Sim 2\.0"):
        V2XSim(written, progress=False)
    for name in NAMES:
        assert NuScenes(written, progress=False).load(name)


def test_processes_share_it(thin: Path) -> None:
    source = NuScenes(thin, progress=False)
    twin = pickle.loads(pickle.dumps(source))
    assert twin.digest == source.digest and twin.names() == NAMES


def edit(root: Path, table: str, change: Callable[[list[dict[str, Any]]], object]) -> None:
    file = root / VERSION / f"{table}.json"
    records = json.loads(file.read_text())
    change(records)
    file.write_text(json.dumps(records))


def _no_lidar(records: list[dict[str, Any]]) -> None:
    records[0]["channel"] = "LIDAR_BACK"


DAMAGE: dict[str, tuple[Callable[[Path], object], str]] = {
    "no LiDAR": (lambda root: edit(root, "sensor", _no_lidar), "no channel LIDAR_TOP: these are no tables of nuScenes"),
    "no time": (
        lambda root: edit(root, "sample_data", lambda records: records[0].pop("timestamp")),
        "lacks 'timestamp'",
    ),
    "time of words": (
        lambda root: edit(root, "sample_data", lambda records: records[0].update(timestamp="noon")),
        "LIDAR_TOP in frame 0: could not convert",
    ),
    "missing sweep": (lambda root: (root / "sweeps/LIDAR_TOP/between.pcd.bin").unlink(), "missing sweep"),
    "cut sweep": (lambda root: (root / "sweeps/LIDAR_TOP/between.pcd.bin").write_bytes(b"123"), "cut short"),
    "no annotation": (lambda root: (root / VERSION / "sample_annotation.json").unlink(), "missing table"),
}


@pytest.mark.parametrize("name", DAMAGE)
def test_what_is_broken_is_named(tmp_path: Path, name: str) -> None:
    break_it, told = DAMAGE[name]
    break_it(by_hand(tmp_path))
    with pytest.raises(BrokenData, match=told):
        NuScenes(tmp_path, sweeps=3, progress=False)
    if "sweep" in name:
        assert NuScenes(tmp_path, progress=False).names(), "sweeps between keyframes are not asked for"


@pytest.mark.parametrize("table", ["sample_data", "ego_pose", "sample_annotation", "scene"])
@given(kind=st.sampled_from(("cut", "flip", "insert", "nest", "number")), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25)
def test_a_damaged_table_is_read_or_refused(
    table: str, kind: str, seed: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    root = by_hand(tmp_path_factory.mktemp("damaged"))
    file = root / VERSION / f"{table}.json"
    file.write_bytes(damaged(file.read_bytes(), kind, random.Random(seed)))
    told = ""
    tracemalloc.start()
    try:
        source = NuScenes(root, sweeps=3, progress=False)
        source.sweeps(source.load(source.names()[0]), [0, 1])
    except (ValueError, IndexError) as error:
        told = str(error)
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        shutil.rmtree(root)
    assert peak < 64 << 20 and len(told) < 2500
