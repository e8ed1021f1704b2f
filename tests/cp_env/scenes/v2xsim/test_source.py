"""V2X-Sim 2.0 as it is distributed: what is written is read back, axes by hand, splits, broken files by name."""

from __future__ import annotations

import json
import pickle
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from cp_env.scenes import Town, open_source
from cp_env.scenes.clip import Clip
from cp_env.scenes.errors import BrokenData
from cp_env.scenes.export import export
from cp_env.scenes.v2xsim import indexing
from cp_env.scenes.v2xsim.source import V2XSim
from cp_env.types import SceneSource
from tests.helpers.toy_scenes import ToySource
from tests.helpers.v2xsim_sets import edit, hand_made

TOWN = Clip(Town("test"), frames=3, vehicles=4)
NAMES = TOWN.names()[:2]


@pytest.fixture(scope="module")
def town_set(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two scenes of the shipped town, three frames, four sensors and the road-side unit."""
    return export(TOWN, tmp_path_factory.mktemp("v2xsim") / "town", names=NAMES)


@pytest.fixture
def copy(thin: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(thin, tmp_path / "set"))


def same(source: SceneSource, other: SceneSource, name: str) -> None:
    """Equal boxes, poses and points, to a millimetre and a milliradian."""
    scene, back = source.load(name), other.load(name)
    seen = np.flatnonzero(~np.isnan(scene.pose[..., 0]).all(axis=0))
    turn = np.array([0, 0, 2 * np.pi]) * np.round((back.pose - scene.pose[:, seen])[..., 2:] / (2 * np.pi))
    assert_allclose(back.pose - turn, scene.pose[:, seen], atol=1e-3)
    assert_allclose(back.size, scene.size[seen], atol=1e-3)
    assert_array_equal(seen[back.connected], scene.connected)
    assert (back.name, back.kind, back.dt) == (scene.name, scene.kind, scene.dt)
    assert (back.rsu is None) == (scene.rsu is None)
    if scene.rsu is not None and back.rsu is not None:
        assert_allclose(back.rsu, scene.rsu, atol=1e-3)
    frames = range(scene.n_frames)
    for row, row_back in zip(source.sweeps(scene, frames), other.sweeps(back, frames), strict=True):
        for sweep, sweep_back in zip(row, row_back, strict=True):
            assert_allclose(sweep_back.points, sweep.points, atol=1e-3)
            assert_allclose(sweep_back.origin, sweep.origin, atol=1e-3)


@pytest.mark.parametrize("name", NAMES)
def test_the_town_comes_back(town_set: Path, name: str) -> None:
    same(TOWN, V2XSim(town_set), name)


def test_what_was_read_can_be_written_again(town_set: Path, tmp_path: Path) -> None:
    once = V2XSim(town_set)
    export(once, tmp_path / "again", names=NAMES[:1])
    twice = V2XSim(tmp_path / "again")
    same(once, twice, NAMES[0])
    assert once.digest != twice.digest


def test_returns_are_counted_nearly_as_the_ray_caster_counts_them(town_set: Path) -> None:
    back = V2XSim(town_set)
    scene, copied = TOWN.load(NAMES[0]), back.load(NAMES[0])
    seen = np.flatnonzero(~np.isnan(scene.pose[..., 0]).all(axis=0))
    for sweep, read in zip(TOWN.sweeps(scene, [0])[0], back.sweeps(copied, [0])[0], strict=True):
        assert sweep.hits is not None and read.hits is not None
        assert abs(int(read.hits.sum()) - int(sweep.hits.sum())) < 0.06 * sweep.hits.sum()
        assert ((read.hits >= 3) == (sweep.hits[seen] >= 3)).mean() > 0.97


@pytest.mark.parametrize("n", [1, 2, 5, 8])
@pytest.mark.parametrize("rsu", [True, False])
def test_any_number_of_agents(tmp_path: Path, n: int, rsu: bool) -> None:
    source = ToySource(n_frames=1, n_connected=n, rsu=rsu)
    export(source, tmp_path / "set", names=["toy-1"])
    same(source, V2XSim(tmp_path / "set"), "toy-1")
    hidden = V2XSim(tmp_path / "set", rsu=False)
    assert hidden.load("toy-1").rsu is None and len(hidden.sweeps(hidden.load("toy-1"), [0])[0]) == n


def test_axes_by_hand(tmp_path: Path) -> None:
    """See the drawing in `hand_made`: sensor (3, 4, -2.05) is world (13, 25, 5.05); the carrier stands at 5.1."""
    source = V2XSim(hand_made(tmp_path, [(3.0, 4.0, -2.05), (3.0, 4.0, -1.5), (-1.0, 0.0, 0.0)]))
    scene = source.load("hand_7")
    assert_allclose(scene.pose, [[[10, 20, np.pi / 2], [13, 25, 0]]], atol=1e-6)
    assert_allclose(scene.size, [[4, 2, 1.5], [4, 2, 1.5]])
    assert scene.connected.tolist() == [0] and scene.rsu is None and scene.kind == "urban"
    ((sweep,),) = source.sweeps(scene, [0])
    assert_allclose(sweep.origin, [10, 20, 2.0], atol=1e-6)
    assert_allclose(sweep.points, [[3, 5, -0.05], [3, 5, 0.5]], atol=1e-6)  # the third point is on its own roof
    assert sweep.hits is not None and sweep.hits.tolist() == [0, 1]  # the road is no vehicle; people are none
    everyone = V2XSim(tmp_path, categories=("vehicle", "human"))
    assert len(everyone.load("hand_7").size) == 3 and everyone.digest != source.digest
    assert source.classes(scene) == ("vehicle.car", "vehicle.car")
    assert everyone.classes(everyone.load("hand_7"))[2] == "human.pedestrian.adult"


def test_a_carrier_that_is_not_annotated_gets_a_box(tmp_path: Path) -> None:
    hand_made(tmp_path, [(0.0, 0.0, 1.0)])
    edit(tmp_path, "sample_annotation", lambda records: records.pop(0))
    source = V2XSim(tmp_path)
    scene = source.load("hand_7")
    assert source.classes(scene) == ("vehicle.car", "not annotated")
    assert_allclose(scene.pose[0], [[13, 25, 0], [10, 21, 0]], atol=1e-6)  # under the LiDAR, and turned as it is
    assert scene.connected.tolist() == [1] and scene.size[1, 0] == 4.7


def test_an_agent_that_is_away_for_a_frame_has_no_radio(copy: Path) -> None:
    def drop(records: list[dict[str, Any]]) -> None:
        records[:] = [r for r in records if "LIDAR_TOP_id_1/toy-0_000001" not in r["filename"]]

    edit(copy, "sample_data", drop)
    source = V2XSim(copy)
    assert source.load("toy-0").n_connected == 1 and source.load("toy-1").n_connected == 2
    assert_array_equal(
        source.load("toy-0").pose[0, source.load("toy-0").connected[0]], ToySource().load("toy-0").pose[0, 1]
    )
    assert V2XSim(copy, vehicles=2).names() == ("toy-1",)
    with pytest.raises(ValueError, match="ask for fewer"):
        V2XSim(copy, vehicles=3)


def test_by_name_with_options(thin: Path) -> None:
    source = open_source(f"v2x-sim:{thin}?scenes=toy-1&rsu=no&skip_broken&progress=false")
    assert isinstance(source, SceneSource) and source.names() == ("toy-1",) and source.load("toy-1").rsu is None
    with pytest.raises(
        ValueError, match=r"unknown option of v2x-sim scenes 'splits' .did you mean 'split'.*known: split, scenes"
    ):
        open_source(f"v2x-sim:{thin}?splits=test")
    with pytest.raises(ValueError, match="vehicles must be a whole number, not 'two'"):
        open_source(f"v2x-sim:{thin}?vehicles=two")
    with pytest.raises(ValueError, match="rsu must be true or false"):
        open_source(f"v2x-sim:{thin}?rsu=perhaps")
    with pytest.raises(ValueError, match="must read kind:path"):
        open_source("v2x-sim:")
    with pytest.raises(ValueError, match="unknown scene 'toy-7'"):
        source.load("toy-7")
    with pytest.raises(ValueError, match=r"unknown scenes 'v2xsim:somewhere'.*v2x-sim:PATH.* no module 'v2xsim'"):
        open_source("v2xsim:somewhere")


def test_sources_are_shared_between_processes(thin: Path) -> None:
    source = V2XSim(thin)
    back = pickle.loads(pickle.dumps(source))
    assert back.digest == source.digest == V2XSim(thin).digest
    same(source, back, "toy-0")
    with pytest.raises(ValueError, match="read-only"):
        source.load("toy-0").pose[0] = 0


def test_tables_are_read_once(thin: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    V2XSim(thin)
    monkeypatch.setattr(indexing, "_Builder", None)
    V2XSim(thin)


def first_file(root: Path) -> Path:
    return root / "sweeps/LIDAR_TOP_id_1/toy-0_000001.pcd.bin"


def _spoil_points(root: Path) -> None:
    points = np.fromfile(first_file(root), dtype=np.float32)
    points[6] = np.nan
    points.tofile(first_file(root))


def _of_scene(records: list[dict[str, Any]], part: str) -> dict[str, Any]:
    return next(record for record in records if part in record["filename"])


def _set(field: str, value: Any, at: int = 0) -> Callable[[list[dict[str, Any]]], None]:
    def change(records: list[dict[str, Any]]) -> None:
        records[at][field] = value

    return change


def _twice(records: list[dict[str, Any]]) -> None:
    records.append({**_of_scene(records, "id_1/toy-0_000001"), "token": "twice"})


def _no_pose(records: list[dict[str, Any]]) -> None:
    _of_scene(records, "id_1/toy-0_000001")["ego_pose_token"] = "nowhere"


def _move_mast(root: Path) -> None:
    shots = json.loads((root / "v2.0/sample_data.json").read_text())
    token = _of_scene(shots, "id_0/toy-0_000001")["ego_pose_token"]

    def change(records: list[dict[str, Any]]) -> None:
        next(record for record in records if record["token"] == token)["translation"][0] += 1.0

    edit(root, "ego_pose", change)


# damage that one scene suffers from: the other one can still be read
def _again(records: list[dict[str, Any]]) -> None:
    records.append(dict(records[0]))


OF_A_SCENE: dict[str, tuple[Callable[[Path], Any], str, str]] = {
    "missing sweep": (lambda root: first_file(root).unlink(), "toy-0_000001.pcd.bin", "missing sweep"),
    "empty sweep": (lambda root: first_file(root).write_bytes(b""), "toy-0_000001.pcd.bin", "empty"),
    "cut sweep": (
        lambda root: first_file(root).write_bytes(first_file(root).read_bytes()[:-3]),
        "toy-0_000001.pcd.bin",
        "cut short",
    ),
    "NaN pose": (
        lambda root: edit(root, "ego_pose", _set("translation", [float("nan"), 0, 0])),
        "ego_pose.json",
        "nan",
    ),
    "null pose": (lambda root: edit(root, "ego_pose", _set("translation", None)), "ego_pose.json", "None"),
    "no rotation": (lambda root: edit(root, "ego_pose", _set("rotation", [2, 0, 0, 0])), "ego_pose.json", "quaternion"),
    "NaN box": (
        lambda root: edit(root, "sample_annotation", _set("size", [1, float("nan"), 1])),
        "sample_annotation.json",
        "nan",
    ),
    "box turned by no rotation": (
        lambda root: edit(root, "sample_annotation", _set("rotation", [2, 0, 0, 0])),
        "sample_annotation.json",
        "quaternion",
    ),
    "no instance": (
        lambda root: edit(root, "sample_annotation", _set("instance_token", "nobody")),
        "sample_annotation.json",
        "'nobody', which is not there",
    ),
    "no ego pose": (lambda root: edit(root, "sample_data", _no_pose), "sample_data.json", "'nowhere'"),
    "no size": (
        lambda root: edit(root, "sample_annotation", _set("size", [1, -2, 1])),
        "sample_annotation.json",
        "size [1, -2, 1] is not positive",
    ),
    "two boxes": (
        lambda root: edit(root, "sample_annotation", _again),
        "sample_annotation.json",
        "two boxes of one instance in frame 0",
    ),
    "two sweeps": (lambda root: edit(root, "sample_data", _twice), "sample_data.json", "two sweeps"),
    "broken chain": (lambda root: edit(root, "sample", _set("next", "lost")), "sample.json", "breaks at 'lost'"),
    "short chain": (lambda root: edit(root, "sample", _set("next", "")), "sample.json", "1 of the scene's 2"),
    "time stands": (lambda root: edit(root, "sample", _set("timestamp", 9e9)), "sample.json", "do not rise"),
    "mast moves": (_move_mast, "set", "V2X-Sim 1.0?"),
}


@pytest.mark.parametrize("damage", OF_A_SCENE)
def test_a_broken_scene_is_named_or_left_out(copy: Path, damage: str) -> None:
    break_it, file, reason = OF_A_SCENE[damage]
    break_it(copy)
    with pytest.raises(BrokenData) as caught:
        V2XSim(copy)
    assert caught.value.file.name == file and reason in caught.value.reason and "toy-0" in caught.value.reason
    source = V2XSim(copy, skip_broken=True)
    assert source.names() == ("toy-1",)
    (left,) = source.left_out
    assert left.scene == "toy-0" and left.file.name == file and reason in left.reason
    assert pickle.loads(pickle.dumps(caught.value)).reason == caught.value.reason


def _drop(root: Path, file: str) -> None:
    (root / "v2.0" / file).unlink()


# damage that no scene can be blamed for: nothing is read, whatever is to be skipped
OF_THE_SET: dict[str, tuple[Callable[[Path], Any], str, str]] = {
    "no tables": (lambda root: shutil.rmtree(root / "v2.0"), "set", "no folder of tables"),
    "missing table": (lambda root: _drop(root, "ego_pose.json"), "ego_pose.json", "missing table"),
    "cut table": (
        lambda root: (root / "v2.0/sample.json").write_text((root / "v2.0/sample.json").read_text()[:-9]),
        "sample.json",
        "cut short",
    ),
    "no list": (lambda root: (root / "v2.0/scene.json").write_text("{}"), "scene.json", "JSON list"),
    "no text": (lambda root: (root / "v2.0/scene.json").write_bytes(b"[\xff]"), "scene.json", "utf-8"),
    "no field": (
        lambda root: edit(root, "sensor", lambda records: records[1].pop("channel")),
        "sensor.json",
        "record 1",
    ),
    "no scene": (lambda root: edit(root, "sample", _set("scene_token", "gone")), "sample.json", "'gone'"),
    "no sample": (lambda root: edit(root, "sample_data", _set("sample_token", "gone")), "sample_data.json", "'gone'"),
    "no category": (lambda root: edit(root, "instance", _set("category_token", "gone")), "instance.json", "'gone'"),
    **{
        f"twice in {table}": (lambda root, table=table: edit(root, table, _again), f"{table}.json", "two records have")
        for table in ("sample", "sensor", "calibrated_sensor", "ego_pose", "instance", "category")
    },
    "two scenes of a name": (lambda root: edit(root, "scene", _again), "scene.json", "'toy-0'"),
    "no record": (
        lambda root: edit(root, "ego_pose", lambda records: records.insert(0, None)),  # type: ignore[arg-type]
        "ego_pose.json",
        "record 0 is None",
    ),
    "no token": (lambda root: edit(root, "instance", _set("token", [1])), "instance.json", "a token is [1]"),
    "no token to refer to": (
        lambda root: edit(root, "sample_data", _set("calibrated_sensor_token", [1])),
        "v2.0",
        "what is no token",
    ),
    "unfit name": (lambda root: edit(root, "scene", _set("name", "../toy")), "scene.json", "'../toy'"),
    "other data": (
        lambda root: edit(root, "sensor", lambda records: [record.update(channel="LIDAR_TOP") for record in records]),
        "sensor.json",
        "no tables of V2X-Sim 2.0",
    ),
    "two versions": (lambda root: shutil.copytree(root / "v2.0", root / "v2.0-mini"), "set", "version="),
    "no set": (lambda root: shutil.rmtree(root), "set", "no such folder"),
}


@pytest.mark.parametrize("damage", OF_THE_SET)
def test_a_broken_set_is_named(copy: Path, damage: str) -> None:
    break_it, file, reason = OF_THE_SET[damage]
    break_it(copy)
    with pytest.raises(BrokenData) as caught:
        V2XSim(copy, skip_broken=True)
    assert caught.value.file.name == file and reason in caught.value.reason


def test_one_of_several_versions(copy: Path) -> None:
    shutil.copytree(copy / "v2.0", copy / "v2.0-mini")
    assert V2XSim(copy, version="v2.0-mini").names() == ("toy-0", "toy-1")


def test_what_no_size_tells_is_found_when_it_is_read(copy: Path) -> None:
    _spoil_points(copy)
    source = V2XSim(copy)
    scene = source.load("toy-0")
    source.sweeps(scene, [0])
    with pytest.raises(BrokenData, match=r"toy-0_000001\.pcd\.bin: it holds coordinates"):
        source.sweeps(scene, [1])
    first_file(copy).unlink()
    with pytest.raises(BrokenData, match=r"toy-0_000001\.pcd\.bin: No such file"):
        source.sweeps(scene, [1])


def test_when_every_scene_is_broken(copy: Path) -> None:
    shutil.rmtree(copy / "sweeps")
    with pytest.raises(ValueError, match="every scene is broken; the first: left out scene toy-0"):
        V2XSim(copy, skip_broken=True)


def test_export_by_name(thin: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="v2x-sim, opv2v"):
        export(TOWN, tmp_path / "new", layout="kitti")
    with pytest.raises(ValueError, match="unknown scene 'village'"):
        export(TOWN, tmp_path / "new", names=["village"])
    with pytest.raises(ValueError, match="is not empty"):
        export(TOWN, thin)
    with pytest.raises(ValueError, match="frames must be at least 1"):
        export(TOWN, tmp_path / "new", frames=0)
    clipped = Clip(ToySource(n_frames=3), frames=2, vehicles=3)
    assert clipped.load("toy-0").n_frames == 2 and clipped.load("toy-0").n_connected == 3
    assert [len(row) for row in clipped.sweeps(clipped.load("toy-0"), [0, 1])] == [4, 4]
