"""coperception's detection files: what its preprocessing keeps of a scene is read back, and no file runs code."""

from __future__ import annotations

import pickle
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cp_env.metrics.ground_truth import truth_boxes
from cp_env.scenes import open_source
from cp_env.scenes.errors import BrokenData
from cp_env.scenes.v2xsim import preprocessed, preprocessed_build
from cp_env.scenes.v2xsim.anchors import decode
from cp_env.scenes.v2xsim.preprocessed import V2XSimDet
from cp_env.testing import check_scenes
from cp_env.testing.scenes import LAWS, LawBroken
from cp_env.types import SceneSource
from tests.helpers.coperception_files import write_files
from tests.helpers.toy_scenes import ToySource

SOURCE = ToySource(n_frames=2, n_connected=3)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The two toy crossings as scenes 5 (test) and 3 (val)."""
    root = tmp_path_factory.mktemp("det")
    write_files(SOURCE, root, "test", {"toy-0": 5})
    write_files(SOURCE, root, "val", {"toy-1": 3})
    return root


@pytest.fixture
def copy(folder: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(folder, tmp_path / "det"))


@pytest.mark.parametrize(("split", "name", "toy"), [("test", "scene_5", "toy-0"), ("val", "scene_3", "toy-1")])
def test_what_the_files_keep_comes_back(folder: Path, split: str, name: str, toy: str) -> None:
    source = V2XSimDet(folder, split=split)
    assert isinstance(source, SceneSource) and source.names() == (name,)
    scene, truth = source.load(name), SOURCE.load(toy)
    assert truth.rsu is not None and scene.rsu is not None
    c, s = np.cos(0.3), np.sin(0.3)  # how the road-side unit is turned in `write_files`
    for t in range(2):
        there = scene.pose[t, ~np.isnan(scene.pose[t, :, 0])]
        place = there[:, :2] @ np.array([[c, s], [-s, c]]) + truth.rsu[:2]
        order = np.lexsort(np.round(place, 3).T), np.lexsort(np.round(truth.pose[t, :, :2], 3).T)
        assert_allclose(place[order[0]], truth.pose[t, order[1], :2], atol=1e-3)
        turn = there[order[0], 2] + 0.3 - truth.pose[t, order[1], 2]
        assert_allclose(np.sin(turn / 2), 0, atol=1e-4)
        assert_allclose(place[scene.connected], truth.pose[t, truth.connected, :2], atol=1e-3)
    sizes = np.sort(scene.size[:, :2], axis=0), np.sort(truth.size[:, :2], axis=0)
    assert_allclose(*sizes, atol=1e-3)  # as many vehicles, of the same sizes: each was followed through all frames
    for row, row_truth in zip(source.sweeps(scene, [1]), SOURCE.sweeps(truth, [1]), strict=True):
        for k, (sweep, sweep_truth) in enumerate(zip(row, row_truth, strict=True)):
            assert abs(sweep.origin[2] - sweep_truth.origin[2]) <= 0.2 + 1e-6  # half a slice
            yaw = 0.3 if k == 3 else truth.pose[1, truth.connected[k], 2]
            own = sweep_truth.points @ _turn(yaw)
            near = (np.abs(own[:, :2]) < 31.9).all(axis=1) & (own[:, 2] < 2.5)
            cloud = sweep.points @ _turn(yaw - 0.3)
            away = np.abs(own[near][::200, None] - cloud[None]).max(axis=2).min(axis=1)
            assert away.max() < 0.45 and np.median(away) < 0.25
    assert source.load(name).n_connected == 3


def _turn(yaw: float) -> np.ndarray:
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


@pytest.mark.parametrize("agent", [1, 2, 3])
def test_their_truth_is_what_their_files_hold(folder: Path, agent: int) -> None:
    """The cars of a file's targets, the carrier's own among them, are `truth_boxes` of their protocol in its frame."""
    truth = SOURCE.load("toy-0")
    content = np.load(folder / f"test/agent{agent}/5_1/0.npy", allow_pickle=True).item()
    held = decode(content["reg_target_sparse"][:, 0], content["allocation_mask"], content["label_sparse"])
    boxes = truth_boxes(truth, 1, int(truth.connected[agent - 1]), 32.0, "coperception", "ego")
    assert len(held) == len(boxes) == len(content["gt_max_iou"])
    away = np.hypot(*(held[:, None, :2] - boxes[None, :, :2]).T)
    held = held[away.argmin(axis=1)]
    assert_allclose(held[:, :4], boxes[:, :4], atol=1e-4)
    assert_allclose(np.sin((held[:, 4] - boxes[:, 4]) / 2), 0, atol=1e-5)
    assert len(truth_boxes(truth, 1, int(truth.connected[agent - 1]), 32.0, axes="ego")) < len(boxes)


def test_returns_lie_in_the_boxes_they_came_from(folder: Path) -> None:
    """Within the voxels' reach, who returns much is hit, and who returns nothing is not."""
    source = V2XSimDet(folder, split="test")
    scene, truth = source.load("scene_5"), SOURCE.load("toy-0")
    place = (scene.pose[0, :, :2] @ np.array([[np.cos(0.3), np.sin(0.3)], [-np.sin(0.3), np.cos(0.3)]])) + 5.0
    row = np.hypot(*(place[:, None] - truth.pose[0, None, :, :2]).T).argmin(axis=0)
    for sweep, reference in zip(source.sweeps(scene, [0])[0], SOURCE.sweeps(truth, [0])[0], strict=True):
        assert sweep.hits is not None and reference.hits is not None
        near = np.hypot(*(truth.pose[0, row, :2] - reference.origin[:2]).T) < 31
        assert sweep.hits[near & (reference.hits[row] >= 20)].min() > 0
        assert sweep.hits[reference.hits[row] == 0].max() <= 3


ROAD = [(ix, 128, 3) for ix in range(100, 120)]  # behind the vehicle: the fullest slice, -2 to -1.6 m


def by_hand(root: Path) -> Path:
    """One frame worked out on paper: a vehicle, the road-side unit, and a car that both see.

    ```
      y ↑        car at (12, 5) of the vehicle's LiDAR, turned left by 0.4; 2 × 4 m
        |      ╱
        |  V ─────→ x       the unit's LiDAR, 6 m up, hangs 10 m ahead of the vehicle's, 1.8 m up: it sees (2, 5)
    ```
    In the files u = -x, v = y. Seen by the vehicle the car is at u = -12, in cell (147, 79) with its middle at
    (-12.125, 4.875); seen by the unit at u = -2, in cell (147, 119) with its middle at (-2.125, 4.875). Both give the
    place code (-0.125 / 2, -0.125 / 4). The vehicle itself is at (0, 0), yaw 0, in cell (128, 128) with its middle at
    (0.125, 0.125): (0.0625, 0.03125); seen by the unit at u = 10, in cell (128, 168), middle (10.125, 0.125): the same.
    Angles: φ = yaw + π/2, from the first anchor's 0: (cos yaw, -sin yaw).
    Returns of the car: its middle (12, 5), 1.5 m ahead of it (12 + 1.5 · 0.92, 5 + 1.5 · 0.39) = (13.38, 5.58), 1.5 m
    behind it (10.62, 4.42), all 0.8 m below the vehicle's LiDAR: voxels of 0.25 m, floor(x / 0.25) + 128, and
    floor(-0.8 / 0.4) + 8 = 6. The unit's are 10 m less far, 5 m below it: floor(-5 / 0.4) + 20 = 7; its road is at -6:
    slice 5, of which the middle is -5.8.
    """
    turned, straight = (0.921061, -0.389418), (1.0, 0.0)
    unit_T_vehicle = np.array([[1.0, 0, 0, -10], [0, 1, 0, 0], [0, 0, 1, -4.2], [0, 0, 0, 1]])
    vehicle_T_unit = np.array([[1.0, 0, 0, 10], [0, 1, 0, 0], [0, 0, 1, 4.2], [0, 0, 0, 1]])
    nobody = np.zeros((4, 4, 4))
    seen = {
        1: ((147, 79), (128, 128), [(176, 148, 6), (181, 150, 6), (170, 145, 6)], ROAD),
        0: ((147, 119), (128, 168), [(136, 148, 7), (141, 150, 7), (130, 145, 7)], [(ix, 128, 5) for ix, _, _ in ROAD]),
    }
    for agent, (car, own, returns, road) in seen.items():
        allocated = np.zeros((256, 256, 6), dtype=bool)
        allocated[*car, 0] = allocated[*own, 0] = True
        codes = {car: (-0.0625, -0.03125, 0.0, 0.0, *turned), own: (0.0625, 0.03125, 0.0, 0.0, *straight)}
        path = root / "test" / f"agent{agent}" / "8_0" / "0.npy"
        path.parent.mkdir(parents=True)
        content = {
            "voxel_indices_0": np.array(returns + road, dtype=np.int32),
            "reg_target_sparse": np.array([codes[cell] for cell in sorted(codes)])[:, None],  # by row, then column
            "label_sparse": np.ones(2, dtype=np.int8),
            "allocation_mask": allocated,
            "target_agent_id": agent,
            "trans_matrices": np.stack(
                [vehicle_T_unit, np.eye(4), *nobody] if agent else [np.eye(4), unit_T_vehicle, *nobody]
            ),
        }
        np.save(path, content)  # type: ignore[arg-type]
    return root


def test_a_file_by_hand(tmp_path: Path) -> None:
    """Boxes stand where their returns are: the car at (2, 5) of the unit's frame, which is the world."""
    source = V2XSimDet(by_hand(tmp_path), progress=False)
    scene = source.load("scene_8")
    assert_allclose(scene.pose[0], [[-10, 0, 0], [2, 5, 0.4]], atol=5e-6)
    assert_allclose(scene.size, [[4, 2, 1.6], [4, 2, 1.6]], atol=5e-6)
    assert scene.rsu is not None and scene.rsu.tolist() == [0, 0, 5.8]  # the middle of the slice of the road
    vehicle, unit = source.sweeps(scene, [0])[0]
    assert vehicle.hits is not None and unit.hits is not None
    assert vehicle.hits.tolist() == [0, 3] and unit.hits.tolist() == [0, 3]
    assert_allclose(vehicle.points[0], [12.125, 5.125, 1.2], atol=1e-6)  # middles: 1.8 m up, 0.6 m down
    assert_allclose(unit.points[0], [2.125, 5.125, 0.8], atol=1e-6)  # 5.8 m up, 5 m down
    assert source.classes(scene) == ("vehicle.car", "vehicle.car")


@pytest.mark.parametrize("wrong", ["mirrored", "turned", "shifted", "swapped"])
def test_a_misreading_of_the_targets_is_found_out(
    folder: Path, wrong: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The law that returns lie in their boxes, alone, would have told: the first reader gave (-x, y, -yaw)."""
    others = [law.__name__ for law in LAWS if law.__name__ != "returns_lie_in_their_box"]

    def misread(*args: Any) -> np.ndarray:
        boxes = decode(*args)
        x, y, _, _, yaw = boxes.T.copy()
        boxes[:, [0, 1, 4]] = {
            "mirrored": np.stack([-x, y, -yaw], axis=1),
            "turned": np.stack([x, y, yaw + np.pi / 2], axis=1),
            "shifted": np.stack([x + 1, y + 1, yaw], axis=1),
            "swapped": np.stack([y, x, np.pi / 2 - yaw], axis=1),
        }[wrong]
        return boxes

    monkeypatch.setenv("CP_ENV_CACHE", str(tmp_path))
    preprocessed._sequence.cache_clear()
    check_scenes(V2XSimDet(folder, split="val", progress=False), scenes=1, frames=1)
    preprocessed._sequence.cache_clear()
    monkeypatch.setenv("CP_ENV_CACHE", str(tmp_path / "other"))
    monkeypatch.setattr(preprocessed_build, "decode", misread)
    with pytest.raises(LawBroken, match=r"only \d+ of \d+ have"):
        check_scenes(V2XSimDet(folder, split="val", progress=False), scenes=1, frames=1, skip=others)
    preprocessed._sequence.cache_clear()


def test_choices(folder: Path) -> None:
    assert open_source(f"v2x-sim-det:{folder}").names() == ("scene_3", "scene_5")
    assert open_source(f"v2x-sim-det:{folder}?scenes=5&rsu=false").load("scene_5").rsu is None
    assert V2XSimDet(folder, vehicles=3).digest != V2XSimDet(folder, split="test").digest
    for wrong, message in (
        ({"split": "train"}, "no files train/agent"),
        ({"split": "tests"}, "split must be one of"),
        ({"scenes": ("7",)}, "'scene_7' is not in split"),
        ({"vehicles": 4}, "ask for fewer"),
    ):
        with pytest.raises(ValueError, match=message):
            V2XSimDet(folder, **wrong)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="unknown scene 'scene_7'"):
        V2XSimDet(folder).load("scene_7")


def test_a_scene_is_put_together_once(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = V2XSimDet(folder)
    preprocessed._sequence.cache_clear()
    monkeypatch.setattr(preprocessed, "read_sequence", None)
    assert V2XSimDet(folder).digest == source.digest == pickle.loads(pickle.dumps(source)).digest


def test_without_the_road_side_units_files(copy: Path) -> None:
    shutil.rmtree(copy / "test/agent0")
    scene = V2XSimDet(copy, split="test").load("scene_5")
    assert scene.rsu is None and scene.n_connected == 3


class Payload:
    """What a hostile file would run when it is read."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.mark,)


def test_a_hostile_file_runs_nothing(copy: Path, tmp_path: Path) -> None:
    file, mark = copy / "test/agent1/5_1/0.npy", tmp_path / "ran"
    content = np.load(file, allow_pickle=True).item()
    np.save(file, {**content, "extra": Payload(mark)})  # type: ignore[arg-type]
    with pytest.raises(BrokenData, match="only arrays and plain containers are read") as caught:
        V2XSimDet(copy)
    assert caught.value.file == file and not mark.exists()
    np.load(file, allow_pickle=True)  # the payload is a real one
    assert mark.exists()


def _change(key: str, change: Callable[[Any], Any]) -> Callable[[Path], None]:
    def apply(path: Path) -> None:
        content = np.load(path, allow_pickle=True).item()
        content[key] = change(content[key])
        np.save(path, content)

    return apply


def _drop(path: Path) -> None:
    content = np.load(path, allow_pickle=True).item()
    del content["trans_matrices"]
    np.save(path, content)


DAMAGE: dict[str, tuple[Callable[[Path], Any], str]] = {
    "missing": (lambda path: path.unlink(), "missing file"),
    "empty": (lambda path: path.write_bytes(b""), "cannot be read"),
    "cut": (lambda path: path.write_bytes(path.read_bytes()[:5000]), "cannot be read"),
    "no dict": (lambda path: np.save(path, np.zeros(3)), "a dict of arrays or 0"),
    "no poses": (_drop, "lacks 'trans_matrices'"),
    "other agent": (_change("target_agent_id", lambda _: 2), "of agent 2, not 1"),
    "NaN pose": (_change("trans_matrices", lambda poses: poses * np.nan), "no finite number"),
    "version 1": (_change("trans_matrices", lambda poses: poses * 0), "V2X-Sim 1.0?"),
    "five agents": (_change("trans_matrices", lambda poses: poses[1:]), "lack the road-side unit"),
    "empty sweep": (_change("voxel_indices_0", lambda voxels: voxels[:0]), "an empty sweep"),
    "voxel outside": (_change("voxel_indices_0", lambda voxels: voxels + 200), "voxel indices must lie"),
    "NaN box": (_change("reg_target_sparse", lambda code: code * np.nan), "a box that is no finite number"),
    "other anchors": (_change("allocation_mask", lambda mask: mask[..., :4]), "six anchors a cell"),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_broken_file_is_named_or_its_scene_left_out(copy: Path, damage: str) -> None:
    file = copy / "test/agent1/5_1/0.npy"
    break_it, reason = DAMAGE[damage]
    break_it(file)
    with pytest.raises(BrokenData) as caught:
        V2XSimDet(copy)
    assert caught.value.file == file and reason in caught.value.reason
    source = V2XSimDet(copy, skip_broken=True)
    assert source.names() == ("scene_3",)
    assert [(left.scene, left.file) for left in source.left_out] == [("scene_5", file)]
