"""Vehicles and sensors of OPV2V that pitch and roll, beside a slow twin: 4 × 4 matrices, one point at a time.

The twin turns about one axis after the other, as CARLA's manual says: roll about x, pitch about y, yaw about z; a
positive pitch lifts the nose, a positive roll lowers the right side, a positive yaw turns to the right. It knows
nothing of the matrix that the reader writes out.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from numpy.testing import assert_allclose

from cp_env.scenes.formats import pcd
from cp_env.scenes.opv2v.source import OPV2V

HALF = (2.0, 1.0, 0.75)


def about(axis: int, angle: float) -> np.ndarray:
    """4 × 4 of a right-handed turn about one axis."""
    i, j = ((1, 2), (2, 0), (0, 1))[axis]
    made = np.eye(4)
    made[i, i] = made[j, j] = math.cos(angle)
    made[j, i] = math.sin(angle)
    made[i, j] = -made[j, i]
    return made


def ours(pose: list[float]) -> np.ndarray:
    """A CARLA pose (x, y, z, roll, yaw, pitch; degrees) in our axes, y to the left: yaw and pitch turn around."""
    x, y, z, roll, yaw, pitch = pose
    made = about(2, -math.radians(yaw)) @ about(1, -math.radians(pitch)) @ about(0, math.radians(roll))
    made[:3, 3] = x, -y, z
    return made


def leaning_drive(root: Path, seed: int) -> dict[str, Any]:
    """The ego (1), a partner (2) and a van (3), each turned at random and up to 8° from upright; 400 points."""
    rng = np.random.default_rng(seed)
    lean = {who: rng.uniform(-8, 8, 2) for who in "123"}
    yaw = dict(zip("123", rng.uniform(-180, 180, 3), strict=True))
    place = {"1": [10.0, 20.0, 5.0], "2": [16.0, 27.0, 5.1], "3": [17.0, 16.0, 4.9]}
    pose = {who: [*place[who], float(lean[who][0]), float(yaw[who]), float(lean[who][1])] for who in "123"}
    center = [0.1, -0.05, 0.75]
    said = {}
    for who in "12":
        mount = np.eye(4)
        mount[:3, 3] = -0.5, 0.0, 1.9
        sensor = ours(pose[who]) @ mount
        lidar = [sensor[0, 3], -sensor[1, 3], sensor[2, 3], *pose[who][3:]]  # it is turned as its vehicle
        others = {int(other): pose[other] for other in "123" if other != who}
        vehicles = {
            other: {"location": p[:3], "angle": p[3:], "center": center, "extent": list(HALF), "speed": 0.0}
            for other, p in others.items()
        }
        said[who] = {"lidar_pose": [float(v) for v in lidar], "true_ego_pos": pose[who], "vehicles": vehicles}
    boxes = {}
    for who in "123":
        shift = np.eye(4)
        shift[:3, 3] = center[0], -center[1], center[2]
        boxes[who] = ours(pose[who]) @ shift
    spread = [(boxes["2"], 130), (boxes["3"], 130), (boxes["1"], 140)]
    world = np.concatenate([rng.normal(box[:3, 3], [1.6, 1.6, 0.9], (n, 3)) for box, n in spread])
    lidar_T_world = np.linalg.inv(ours(said["1"]["lidar_pose"]))
    points = [(lidar_T_world @ [*point, 1.0])[:3] * [1, -1, 1] for point in world]
    for who in "12":
        folder = root / "drive" / who
        folder.mkdir(parents=True)
        for number in ("000000", "000002"):
            (folder / f"{number}.yaml").write_text(yaml.safe_dump(said[who]))
            pcd.write(folder / f"{number}.pcd", np.array(points, dtype=np.float32))
    stored = np.array(points, dtype=np.float32).astype(np.float64) * [1, -1, 1]
    seen = [(ours(said["1"]["lidar_pose"]) @ [*point, 1.0])[:3] for point in stored]
    return {"boxes": boxes, "points": seen, "foot": pose["1"][2], "sensor": ours(said["1"]["lidar_pose"])}


def lies_in(box: np.ndarray, point: np.ndarray, *, tall: bool) -> bool:
    """In a box 5 cm larger and without its lowest 10 cm; or over or under it."""
    x, y, z, _ = np.linalg.inv(box) @ [*point, 1.0]
    length, width, height = HALF
    inside = abs(x) <= length + 0.05 and abs(y) <= width + 0.05
    return bool(inside and (tall or 0.1 - height <= z <= height + 0.05))


@pytest.mark.parametrize("seed", range(6))
def test_points_and_hits_are_the_twins(tmp_path: Path, seed: int) -> None:
    made = leaning_drive(tmp_path, seed)
    source = OPV2V(tmp_path, stride=1)
    scene = source.load("drive")
    sweep = source.sweeps(scene, [0])[0][0]
    own = made["boxes"]["1"]
    heading = math.atan2(own[1, 0], own[0, 0])
    expected, hits = [], [0, 0, 0]
    for point in made["points"]:
        x, y = point[:2] - own[:2, 3]
        c, s = math.cos(heading), math.sin(heading)
        from_above = abs(c * x + s * y) <= 2.05 and abs(c * y - s * x) <= 1.05
        if lies_in(own, point, tall=True) or from_above:
            continue
        expected.append([x, y, point[2] - made["foot"]])
        hits[1] += lies_in(made["boxes"]["2"], point, tall=False)
        hits[2] += lies_in(made["boxes"]["3"], point, tall=False)
    assert_allclose(sweep.points, expected, atol=1e-4)
    assert min(hits[1:]) > 20 and sweep.hits is not None and sweep.hits.tolist() == hits
    assert_allclose(sweep.origin, [*own[:2, 3], made["sensor"][2, 3] - made["foot"]], atol=1e-6)
    for row, who in enumerate("123"):
        box = made["boxes"][who]
        assert_allclose(scene.pose[0, row, :2], box[:2, 3], atol=1e-9)
        assert_allclose(math.sin(scene.pose[0, row, 2] - math.atan2(box[1, 0], box[0, 0])), 0, atol=1e-9)


def test_upright_boxes_would_count_otherwise(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """So the twin can fail: without the lean, returns are counted in boxes that stand upright."""
    made = leaning_drive(tmp_path, 0)
    source = OPV2V(tmp_path, stride=1)
    leaning = source.sweeps(source.load("drive"), [0])[0][0].hits
    monkeypatch.setattr("cp_env.scenes.assembly.sweep.leaning", lambda tilt: np.zeros(0, dtype=np.int64))
    upright = source.sweeps(source.load("drive"), [0])[0][0].hits
    assert leaning is not None and upright is not None and leaning.tolist() != upright.tolist() and made["foot"] == 5.0
