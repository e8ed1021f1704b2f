"""DAIR-V2X-C: a crossing by hand, what is written comes back, laws, splits, broken files, and an episode."""

from __future__ import annotations

import json
import os
import pickle
import random
import shutil
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

import agents.sb3
import cp_env
from cp_env.scenes import open_source
from cp_env.scenes.dair_v2x.source import DairV2X
from cp_env.scenes.errors import BrokenData
from cp_env.testing import check_scenes
from cp_env.testing.scenes import LawBroken
from cp_env.types import SceneSource
from cp_env.world.world import World
from tests.helpers.dair_sets import OFFSET, by_hand, write_set
from tests.helpers.damage import damaged
from tests.helpers.toy_scenes import ToySource

TOY = ToySource(n_frames=3, n_connected=2)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_set(TOY, tmp_path_factory.mktemp("dair"))


@pytest.fixture(scope="module")
def thin(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_set(TOY, tmp_path_factory.mktemp("dair"), every=200)


@pytest.fixture
def copy(thin: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(thin, tmp_path / "set"))


def test_a_crossing_by_hand(tmp_path: Path) -> None:
    """See the drawing in `by_hand`: both LiDARs meet the van's middle at half its height; the ego is in the middle."""
    source = open_source(f"dair-v2x:{by_hand(tmp_path)}?stride=1")
    assert isinstance(source, DairV2X) and source.names() == ("batch-7",)
    scene = source.load("batch-7")
    assert scene.dt == pytest.approx(0.1) and scene.n_frames == 3 and scene.rsu is None
    assert source.classes(scene) == ("vehicle", "unit", "van"), "a pedestrian is no vehicle"
    assert_allclose(scene.pose[1], [[101, 50, 0], [110, 40, 0], [112, 58, np.pi]], atol=1e-9)
    assert_allclose(scene.size[2], [5, 2, 2])
    for t, (ego, unit) in enumerate(source.sweeps(scene, range(3))):
        assert_allclose(ego.origin, [100 + t, 50, 2], atol=1e-6)
        assert_allclose(unit.origin, [110, 40, 6], atol=1e-6)
        assert_allclose(ego.points, [[12 - t, 8, 1], [3, 3, 0], [9, -1, 0]], atol=1e-5)
        assert_allclose(unit.points, [[2, 18, 1], [-1, 1, 0]], atol=1e-5)
        assert ego.hits is not None and unit.hits is not None
        assert ego.hits.tolist() == [0, 0, 1] and unit.hits.tolist() == [0, 0, 1]


def test_without_the_offset_the_units_points_lie_where_its_calibration_puts_them(tmp_path: Path) -> None:
    """The offset of the set is what was found wrong with it: 0.7 and -0.4 m."""
    folder = by_hand(tmp_path)
    mended, raw = DairV2X(folder, stride=1), DairV2X(folder, stride=1, offset=False)
    here, there = (source.sweeps(source.load("batch-7"), [0])[0][1] for source in (mended, raw))
    assert_allclose(there.points + there.origin, here.points + here.origin - (*OFFSET, 0), atol=1e-5)
    assert mended.digest != raw.digest


@pytest.mark.parametrize("unit", ["sender", "rsu"])
def test_what_is_written_keeps_the_laws(written: Path, unit: str) -> None:
    source = DairV2X(written, unit=unit, stride=1)
    assert isinstance(source, SceneSource) and len(check_scenes(source)) > 15


def test_what_is_written_comes_back(written: Path) -> None:
    """Vehicles are followed though labels come in another order each time, and the ego is labelled now and then."""
    source = DairV2X(written, unit="rsu", stride=1)
    for name, toy in zip(source.names(), TOY.names(), strict=True):
        scene, truth = source.load(name), TOY.load(toy)
        assert scene.dt == pytest.approx(0.2) and len(scene.size) == len(truth.size)
        away = np.hypot(*(scene.pose[0, :, None, :2] - truth.pose[0, None, :, :2]).T).T
        order = away.argmin(axis=1)
        assert sorted(order) == list(range(len(truth.size))) and order[0] == truth.connected[0]
        assert_allclose(scene.pose[..., :2], truth.pose[:, order, :2], atol=1e-6)
        assert_allclose(np.sin((scene.pose[..., 2] - truth.pose[:, order, 2]) / 2), 0, atol=1e-6)
        assert_allclose(scene.size, truth.size[order], atol=1e-6)
        assert scene.rsu is not None and truth.rsu is not None
        assert_allclose(scene.rsu, truth.rsu, atol=1e-6)
        for row, expected in zip(source.sweeps(scene, range(3)), TOY.sweeps(truth, range(3)), strict=True):
            for sweep, wanted in zip(row, (expected[0], expected[-1]), strict=True):
                near = np.hypot(*wanted.points[:, :2].T) > 3  # none of its own
                assert abs(len(sweep.points) - len(wanted.points)) <= (~near).sum()
                assert sweep.hits is not None and wanted.hits is not None
                assert ((sweep.hits >= 3) == (wanted.hits[order] >= 3)).mean() > 0.9


@pytest.mark.parametrize("fault", ["x mirrored", "heading", "offset", "order of corners"])
def test_misreadings_break_a_law(written: Path, fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Mutants: what a reader of this set gets wrong is seen by `check_scenes`."""
    from cp_env.scenes.dair_v2x import source as module

    if fault == "x mirrored":
        monkeypatch.setattr(module, "read_points", lambda file: _read(file) * np.array([-1, 1, 1], dtype=np.float32))
    elif fault == "heading":
        monkeypatch.setattr(
            "cp_env.scenes.dair_v2x.files.attitude", lambda turn: _attitude(turn) + np.array([0.6, 0, 0])
        )
    elif fault == "offset":
        monkeypatch.setattr(module, "unit_pose", lambda root, pair, offset: _shifted(root, pair))
    else:
        monkeypatch.setattr(module, "read_labels", lambda root, pair: _swapped(root, pair))
    with pytest.raises(LawBroken):
        check_scenes(DairV2X(written, stride=1))


def _read(file: Path) -> np.ndarray:
    from cp_env.scenes.opv2v.files import read_points

    return read_points(file)


def _attitude(turn: np.ndarray) -> np.ndarray:
    from cp_env.scenes.assembly.tilt import attitude

    return attitude(turn)


def _shifted(root: Path, pair: object) -> np.ndarray:
    from cp_env.scenes.dair_v2x.files import unit_pose

    pose = unit_pose(root, pair, offset=True)  # type: ignore[arg-type]
    pose[:2, 3] += 3.0
    return pose


def _swapped(root: Path, pair: object) -> object:
    from dataclasses import replace

    from cp_env.scenes.dair_v2x.files import read_labels

    said = read_labels(root, pair)  # type: ignore[arg-type]
    boxes = said.boxes.copy()
    boxes[:, [3, 4]] = boxes[:, [4, 3]]
    return replace(said, boxes=boxes)


def test_splits_are_read_from_the_users_file(written: Path) -> None:
    assert DairV2X(written, split="val").names() == ("batch-0",)
    assert DairV2X(written, split="train").names() == ("batch-1",)
    assert DairV2X(written).names() == ("batch-0", "batch-1")
    with pytest.raises(ValueError, match=r"unknown split 'vla' .did you mean 'val'"):
        DairV2X(written, split="vla")
    with pytest.raises(ValueError, match="no scene of dair-v2x/test"):
        DairV2X(written, split="test")


def test_environments_play_the_vehicle_and_the_unit(thin: Path) -> None:
    """Two senders, of which one may be malicious; with `unit=rsu` there is one vehicle, and the message says so."""
    scenes = f"dair-v2x:{thin}?stride=1"
    env = cp_env.parallel_env("ego_only", scenes=scenes, n_vehicles=2, n_attackers=1, action="basis", max_frames=2)
    env.reset(seed=0)
    *_, infos = env.step({agent: env.action_space(agent).sample() for agent in env.agents})
    assert all(np.isfinite(info["damage"]) for info in infos.values())
    with pytest.raises(ValueError, match=r"only 1 connected vehicle; take n_vehicles=1 with rsu=True, or choose other"):
        cp_env.parallel_env("ego_only", scenes=f"{scenes}&unit=rsu", n_vehicles=2, n_attackers=1)
    with pytest.raises(ValueError, match="has 1 connected vehicles with unit=rsu, not 2"):
        open_source(f"{scenes}&unit=rsu&vehicles=2")


APIS: dict[str, Callable[..., Any]] = {
    "parallel": lambda **options: cp_env.parallel_env("prbi", **options),
    "aec": lambda **options: cp_env.env("prbi", **options),
    "vector": lambda **options: cp_env.vector_env(2, "prbi", **options),
    "gymnasium": lambda **options: gymnasium.make("cp_env/CollaborativePerception-v0", defender="prbi", **options),
    "sb3": lambda **options: agents.sb3.make_vec_env(1, "prbi", **options),
}


@pytest.mark.parametrize("api", APIS)
def test_one_vehicle_and_the_road_side_unit_play_at_every_api(thin: Path, api: str) -> None:
    """No mast is a vehicle then, so that it is no truth that nobody finds."""
    made = APIS[api](
        scenes=f"dair-v2x:{thin}?stride=1&unit=rsu", n_vehicles=1, rsu=True, n_attackers=1, action="basis", max_frames=2
    )
    if api == "sb3":
        made.seed(0)
        made.reset()
    else:
        made.reset(seed=0)
    if api == "parallel":
        *_, infos = made.step({agent: made.action_space(agent).sample() for agent in made.agents})
        assert all(np.isfinite(info["damage"]) for info in infos.values())
    made.close()


def test_either_of_one_vehicle_and_the_unit_may_be_malicious(thin: Path) -> None:
    world = World(
        1, defender="prbi", scenes=f"dair-v2x:{thin}?stride=1&unit=rsu", n_vehicles=1, rsu=True, n_attackers=1
    )
    drawn = set()
    for seed in range(8):
        world.reset([seed])
        drawn.add(int(world.attackers[0, 0]))
    assert drawn == {0, 1}
    outcome = world.step(torch.zeros(world.situation().delta_shape))
    assert outcome.output[0].group <= {0, 1} and len(outcome.truth[0]) == len(world.places[0][0].truth[0])


def test_bad_options_are_named(thin: Path) -> None:
    for query, told in (
        ("unit=mast", "unit must be one of sender, rsu; got 'mast'"),
        ("stride=0", "stride and frames must be at least 1"),
        ("frames=99", "no scene of dair-v2x/all .* has 99 frames"),
        ("scenes=batch-9", "unknown scene 'batch-9'.*holds batch-0, batch-1"),
        ("vehicles=3", "has 2 connected vehicles with unit=sender, not 3"),
        ("splits=val", "did you mean 'split'"),
    ):
        with pytest.raises(ValueError, match=told):
            open_source(f"dair-v2x:{thin}?{query}")
    with pytest.raises(ValueError, match="unknown scene 'batch-5'"):
        DairV2X(thin).load("batch-5")


def test_a_missing_file_is_named_or_costs_its_frame(copy: Path) -> None:
    lost = copy / "cooperative-vehicle-infrastructure/infrastructure-side/velodyne/006001.pcd"
    lost.unlink()
    with pytest.raises(BrokenData, match=r"velodyne.006001\.pcd: is missing"):
        DairV2X(copy)
    source = DairV2X(copy, stride=1, frames=1, skip_broken=True)
    assert source.names() == ("batch-0", "batch-1@001000", "batch-1@001002")
    assert [item.file.name for item in source.left_out] == ["006001.pcd"]


def test_sources_are_shared_between_processes_and_know_their_files(copy: Path) -> None:
    source = DairV2X(copy, stride=1)
    twin = pickle.loads(pickle.dumps(source))
    assert twin.digest == source.digest == DairV2X(copy, stride=1).digest
    file = next(copy.glob("*/vehicle-side/velodyne/*.pcd"))
    os.utime(file, ns=(0, 0))
    assert DairV2X(copy, stride=1).digest != source.digest


FILES = (
    "cooperative/data_info.json",
    "vehicle-side/data_info.json",
    "cooperative/label_world/000000.json",
    "vehicle-side/calib/lidar_to_novatel/000000.json",
    "infrastructure-side/calib/virtuallidar_to_world/005000.json",
    "vehicle-side/velodyne/000000.pcd",
)


@pytest.mark.parametrize("name", FILES)
@given(kind=st.sampled_from(("cut", "flip", "insert", "nest", "number")), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25)
def test_a_damaged_file_is_read_or_refused(
    name: str, kind: str, seed: int, thin: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Small damage: scenes of numbers, or a ValueError; little memory either way."""
    file = thin / "cooperative-vehicle-infrastructure" / name
    whole = file.read_bytes()
    told = ""
    tracemalloc.start()
    try:
        file.write_bytes(damaged(whole, kind, random.Random(seed)))
        source = DairV2X(thin, stride=1)
        scene = source.load(source.names()[0])
        source.sweeps(scene, [0])
        assert np.isfinite(scene.pose[:, scene.connected]).all()
    except ValueError as error:
        told = str(error)
    finally:
        file.write_bytes(whole)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert peak < 64 << 20 and len(told) < 2500
    assert json.loads((thin / "cooperative-vehicle-infrastructure/cooperative/data_info.json").read_text())
