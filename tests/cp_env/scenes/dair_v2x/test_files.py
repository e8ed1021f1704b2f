"""The files of DAIR-V2X-C by hand: pairs, calibration chains, corners, and what is wrong with each of them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from cp_env.scenes.dair_v2x import files
from cp_env.scenes.dair_v2x.files import Pair, read_labels, read_pairs, unit_pose, vehicle_pose
from cp_env.scenes.errors import BrokenData
from tests.helpers.dair_sets import by_hand, corners

PAIR = Pair("000010", "005010", "7", 0, None)


def write(root: Path, file: str, said: Any) -> Path:
    path = root / file
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(said if isinstance(said, str) else json.dumps(said))
    return path


def test_pairs_by_hand(tmp_path: Path) -> None:
    root = by_hand(tmp_path) / files.INNER
    first, second, _ = read_pairs(root)
    assert first == Pair("000010", "005010", "7", 1_626_165_000_000_000, (0.7, -0.4))
    assert (second.vehicle, second.time - first.time) == ("000011", 100_000)
    assert files.find_root(tmp_path) == files.find_root(root) == root


def test_a_chain_by_hand(tmp_path: Path) -> None:
    """A LiDAR 1 m ahead of a receiver that looks along y and stands at (5, 6, 7): it is at (5, 7, 7), and its x is y.

    The receiver's file has its rotation as one row after the other, and its translation as three numbers.
    """
    quarter = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    lidar = {"transform": {"rotation": np.eye(3).tolist(), "translation": {"a": 1}}}
    write(tmp_path, "vehicle-side/calib/novatel_to_world/000010.json", {"rotation": quarter, "translation": [5, 6, 7]})
    file = write(tmp_path, "vehicle-side/calib/lidar_to_novatel/000010.json", lidar)
    with pytest.raises(BrokenData, match=r"000010\.json: .*"):
        vehicle_pose(tmp_path, PAIR)
    lidar["transform"]["translation"] = [[1], [0], [0]]
    file.write_text(json.dumps(lidar))
    found = vehicle_pose(tmp_path, PAIR)
    assert_allclose(found @ [0, 0, 0, 1], [5, 7, 7], atol=1e-12)
    assert_allclose(found @ [2, 0, 0, 1], [5, 9, 7], atol=1e-12)
    assert_allclose(found @ [0, 3, 1, 1], [2, 7, 8], atol=1e-12)


@pytest.mark.parametrize(
    ("pair", "relative", "expected"),
    [
        ((0.5, -0.25), {"delta_x": 9, "delta_y": 9}, (10.5, 19.75)),
        (None, {"delta_x": 0.1, "delta_y": -0.2}, (10.1, 19.8)),
        (None, {"delta_x": "", "delta_y": ""}, (10, 20)),
        (None, "", (10, 20)),
        ((0.0, 0.0), {"delta_x": 9, "delta_y": 9}, (10, 20)),
    ],
)
def test_the_offset_is_the_pairs_or_else_the_calibrations(
    tmp_path: Path, pair: tuple[float, float] | None, relative: Any, expected: tuple[float, float]
) -> None:
    """They are one error, measured twice: never both."""
    said = {"rotation": np.eye(3).tolist(), "translation": [[10], [20], [6]], "relative_error": relative}
    write(tmp_path, "infrastructure-side/calib/virtuallidar_to_world/005010.json", said)
    given = Pair("000010", "005010", "7", 0, pair)
    assert_allclose(unit_pose(tmp_path, given, offset=True)[:, 3], [*expected, 6])
    assert_allclose(unit_pose(tmp_path, given, offset=False)[:, 3], [10, 20, 6])


def test_a_calibration_that_is_nearly_a_rotation_is_made_one(tmp_path: Path) -> None:
    turn = Rotation.from_euler("zyx", [1.0, 0.1, -0.05]).as_matrix()
    said = {"rotation": (turn + 0.004).tolist(), "translation": [[0], [0], [0]]}
    file = write(tmp_path, "infrastructure-side/calib/virtuallidar_to_world/005010.json", said)
    found = unit_pose(tmp_path, PAIR, offset=True)[:, :3]
    assert_allclose(found @ found.T, np.eye(3), atol=1e-12)
    assert_allclose(found, turn, atol=0.01)
    for bad in (np.diag([1.0, -1, 1]), 1.2 * np.eye(3), np.zeros((3, 3))):
        file.write_text(json.dumps({**said, "rotation": bad.tolist()}))
        with pytest.raises(BrokenData, match=r"005010\.json: rotation is no right-handed rotation"):
            unit_pose(tmp_path, PAIR, offset=True)


def test_a_box_by_its_corners(tmp_path: Path) -> None:
    """4 × 2 × 1.5 m at (10, 20, 5.75), heading 30°; what the file says of sizes and angles is of no world."""
    box = [10.0, 20.0, 5.75, 4.0, 2.0, 1.5, np.deg2rad(30)]
    said = [{"type": "Car", "world_8_points": corners(box), "3d_dimensions": {"l": 9}, "rotation": 7}]
    flat = corners([0, 0, 0, 4, 2, 0, 0])
    write(tmp_path, "cooperative/label_world/000010.json", [*said, {"type": "car", "world_8_points": flat}])
    found = read_labels(tmp_path, PAIR)
    assert found.kinds == ("Car",), "what has no height is no object"
    assert_allclose(found.boxes, [box], atol=1e-9)
    assert_allclose(found.tilt, [[0, 0]], atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_leaning_boxes_come_back(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    size, middle = rng.uniform(1, 6, 3), rng.uniform(-50, 50, 3)
    yaw, pitch, roll = rng.uniform([-3, -0.2, -0.2], [3, 0.2, 0.2])
    turn = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    points = np.array(corners([0, 0, 0, *size, 0])) @ turn.T + middle
    points += rng.normal(0, 0.005, (8, 3))
    write(tmp_path, "cooperative/label_world/000010.json", [{"type": "car", "world_8_points": points.tolist()}])
    found = read_labels(tmp_path, PAIR)
    assert_allclose(found.boxes[0], [*middle, *size, yaw], atol=0.03)
    assert_allclose(found.tilt[0], [roll, pitch], atol=0.03)


def _set(file: str, change: Callable[[Any], Any]) -> Callable[[Path], None]:
    def edit(root: Path) -> None:
        path = root / file
        said = json.loads(path.read_text())
        made = change(said)
        path.write_text(json.dumps(said if made is None else made))

    return edit


LABEL, PAIRS, SIDE = "cooperative/label_world/000010.json", "cooperative/data_info.json", "vehicle-side/data_info.json"
NOVATEL, UNIT = (
    "vehicle-side/calib/novatel_to_world/000010.json",
    "infrastructure-side/calib/virtuallidar_to_world/005010.json",
)
DAMAGE: dict[str, tuple[Callable[[Path], Any], str]] = {
    "no json": (lambda root: (root / LABEL).write_text("{"), "000010.json: is no JSON"),
    "no list": (lambda root: (root / LABEL).write_text("{}"), "000010.json: must hold a JSON list of records"),
    "deep": (lambda root: (root / LABEL).write_text("[" * 10**5), "000010.json: is no JSON.*nested deeper"),
    "long": (lambda root: (root / LABEL).write_bytes(b" " * (5 << 20)), "000010.json: is no JSON.*at most 4194304"),
    "seven corners": (
        _set(LABEL, lambda said: said[0]["world_8_points"].pop() and None),
        "record 0: world_8_points must be",
    ),
    "no corners": (_set(LABEL, lambda said: [{"type": "car"}]), "record 0: lacks 'world_8_points'"),
    "NaN": (_set(LABEL, lambda said: said[0]["world_8_points"][3].__setitem__(1, float("nan"))), "finite numbers"),
    "words": (_set(LABEL, lambda said: said[0].__setitem__("world_8_points", "abc")), "record 0: could not convert"),
    "no box": (_set(LABEL, lambda said: said[0]["world_8_points"][0].__setitem__(0, 99.0)), "no corners of a box"),
    "upside down": (_set(LABEL, lambda said: said[0]["world_8_points"].reverse()), "no corners of a box"),
    "no rotation": (_set(NOVATEL, lambda said: said.pop("rotation") and None), "novatel_to_world.000010.json: lacks"),
    "rotation of two": (_set(NOVATEL, lambda said: {**said, "rotation": [[1, 0], [0, 1]]}), "must be 3 × 3 and three"),
    "no object": (lambda root: (root / NOVATEL).write_text("[]"), "000010.json: must hold a JSON object"),
    "offset of words": (_set(UNIT, lambda said: {**said, "relative_error": {"delta_x": "far"}}), "could not convert"),
    "offset of none": (_set(UNIT, lambda said: {**said, "relative_error": [1]}), "an offset must be a table"),
    "infinite": (_set(UNIT, lambda said: {**said, "relative_error": {"delta_x": 1e999}}), "must be finite"),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_what_is_wrong_with_a_frame_is_named(tmp_path: Path, damage: str) -> None:
    break_it, told = DAMAGE[damage]
    root = by_hand(tmp_path) / files.INNER
    break_it(root)
    with pytest.raises(BrokenData, match=told.replace("(", r"\(")):
        read_labels(root, PAIR), vehicle_pose(root, PAIR), unit_pose(root, PAIR, offset=True)


PAIR_DAMAGE: dict[str, tuple[Callable[[Path], Any], str]] = {
    "no pair": (lambda root: (root / PAIRS).write_text("[]"), "holds no pair of frames"),
    "no path": (_set(PAIRS, lambda said: said[1].pop("vehicle_pointcloud_path") and None), "record 1: lacks"),
    "no number": (
        _set(PAIRS, lambda said: said[0].update(vehicle_pointcloud_path="a/b.pcd")),
        "'a/b.pcd' names no frame",
    ),
    "unknown frame": (_set(SIDE, lambda said: said[1:]), "record 0: it names the vehicle's frame 000010"),
    "no time": (_set(SIDE, lambda said: said[0].pop("pointcloud_timestamp") and None), "record 0: lacks"),
    "time of words": (
        _set(SIDE, lambda said: said[0].update(pointcloud_timestamp="noon")),
        "record 0: invalid literal",
    ),
    "no file": (lambda root: (root / SIDE).unlink(), "vehicle-side.data_info.json: cannot be read"),
    "V2X-Seq": (
        lambda root: (root / PAIRS).write_text('[{"vehicle_frame": "1", "infrastructure_frame": "2"}]'),
        "is V2X-Seq's",
    ),
}


@pytest.mark.parametrize("damage", PAIR_DAMAGE)
def test_what_is_wrong_with_the_pairs_is_named(tmp_path: Path, damage: str) -> None:
    break_it, told = PAIR_DAMAGE[damage]
    root = by_hand(tmp_path) / files.INNER
    break_it(root)
    with pytest.raises(BrokenData, match=told):
        read_pairs(root)


def test_where_to_point(tmp_path: Path) -> None:
    with pytest.raises(BrokenData, match=r"holds no cooperative/data_info\.json; point to the folder"):
        files.find_root(tmp_path)
