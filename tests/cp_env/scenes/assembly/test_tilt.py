"""Vehicles that pitch and roll, beside a slow twin: 4 × 4 matrices from quaternions, one point at a time.

python -m pytest tests/cp_env/scenes/assembly/test_tilt.py -k planar -s     # what a planar warp would be wrong by
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cp_env.lidar.returns import count_returns as count_upright
from cp_env.scenes.assembly import tilt
from cp_env.scenes.v2xsim.preprocessed_build import HEIGHT, in_world
from cp_env.scenes.v2xsim.source import V2XSim
from tests.helpers.v2xsim_sets import edit, hand_made

Matrix = list[list[float]]


def hamilton(a: list[float], b: list[float]) -> list[float]:
    """The product of two quaternions (w, x, y, z)."""
    return [
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    ]


def quaternion(yaw: float, pitch: float, roll: float) -> list[float]:
    """First rolled, then pitched, then turned."""
    about = [[math.cos(a / 2), *(math.sin(a / 2) * e for e in axis)] for a, axis in zip(
        (yaw, pitch, roll), ((0, 0, 1), (0, 1, 0), (1, 0, 0)), strict=True)]  # fmt: skip
    return hamilton(hamilton(about[0], about[1]), about[2])


def matrix(q: list[float], shift: list[float]) -> np.ndarray:
    """4 × 4 of a rotation and then a shift: each axis is turned by q · axis · q*."""
    back = [q[0], -q[1], -q[2], -q[3]]
    columns = [hamilton(hamilton(q, [0.0, *axis]), back)[1:] for axis in np.eye(3).tolist()]
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = np.array(columns).T, shift
    return made


def leaning_set(root: Path, seed: int) -> tuple[Path, dict[str, Any]]:
    """The hand-made set with every frame turned at random, up to 0.15 rad from upright; 400 points round both cars."""
    rng = np.random.default_rng(seed)
    yaws = dict(zip(("ego", "mount", "i", "j"), rng.uniform(-math.pi, math.pi, 4), strict=True))
    leans = {name: rng.uniform(-0.15, 0.15, 2) for name in yaws}
    yaws["i"], leans["i"] = yaws["ego"], leans["ego"]
    turn = {name: quaternion(yaws[name], *leans[name]) for name in yaws}
    shift = {"ego": [10.0, 20.0, 5.1], "mount": [0.4, 0.1, 2.0], "j": [14.0, 25.0, 5.9]}
    world_T_ego = matrix(turn["ego"], shift["ego"])
    shift["i"] = (world_T_ego @ [0.0, 0.0, 0.75, 1.0])[:3].tolist()
    world_T_sensor = world_T_ego @ matrix(turn["mount"], shift["mount"])
    places = np.concatenate([rng.normal(shift["j"], [1.6, 1.6, 0.8], (300, 3)), rng.normal(shift["i"], 1.2, (100, 3))])
    sensor_T_world = np.linalg.inv(world_T_sensor)
    points = [tuple((sensor_T_world @ [*place, 1.0])[:3]) for place in places]
    hand_made(root, points)

    def poses(records: list[dict[str, Any]]) -> None:
        records[0]["rotation"] = turn["ego"]

    def mounts(records: list[dict[str, Any]]) -> None:
        records[0].update(rotation=turn["mount"], translation=shift["mount"])

    def boxes(records: list[dict[str, Any]]) -> None:
        for record in records:
            if (name := record["instance_token"]) in ("i", "j"):
                record.update(rotation=turn[name], translation=shift[name])

    edit(root, "ego_pose", poses)
    edit(root, "calibrated_sensor", mounts)
    edit(root, "sample_annotation", boxes)
    boxes_at = {name: matrix(turn[name], shift[name]) for name in ("i", "j")}
    return root, {"world_T_sensor": world_T_sensor, "boxes": boxes_at, "points": points}


def lies_in(world_T_box: np.ndarray, world: np.ndarray, *, tall: bool) -> bool:
    """Whether a point lies in a box of 4 × 2 × 1.5 m, 5 cm larger and without its lowest 10 cm, or over or under it."""
    x, y, z, _ = np.linalg.inv(world_T_box) @ world
    return bool(abs(x) <= 2.05 and abs(y) <= 1.05 and (tall or -0.65 <= z <= 0.8))


@pytest.mark.parametrize("seed", range(8))
def test_points_and_hits_are_the_twins(tmp_path: Path, seed: int) -> None:
    root, made = leaning_set(tmp_path, seed)
    source = V2XSim(root, progress=False)
    scene = source.load("hand_7")
    ((sweep,),) = source.sweeps(scene, [0])
    own, other = made["boxes"]["i"], made["boxes"]["j"]
    foot = (own @ [0.0, 0.0, -0.75, 1.0])[2]
    heading = math.atan2(own[1, 0], own[0, 0])
    expected, hits = [], 0
    for point in made["points"]:
        world = made["world_T_sensor"] @ [*np.float32(point).tolist(), 1.0]
        x, y = world[:2] - own[:2, 3]
        c, s = math.cos(heading), math.sin(heading)
        seen_from_above = abs(c * x + s * y) <= 2.05 and abs(c * y - s * x) <= 1.05
        if lies_in(own, world, tall=True) or seen_from_above:
            continue
        expected.append([x, y, world[2] - foot])
        hits += lies_in(other, world, tall=False)
    assert_allclose(sweep.points, expected, atol=1e-4)
    assert hits > 30 and sweep.hits is not None and sweep.hits.tolist() == [0, hits]
    assert_allclose(sweep.origin, [*own[:2, 3], made["world_T_sensor"][2, 3] - foot], atol=1e-6)
    for row, box in enumerate((own, other)):
        assert_allclose(scene.pose[0, row, :2], box[:2, 3], atol=1e-9)
        assert_allclose(math.sin(scene.pose[0, row, 2] - math.atan2(box[1, 0], box[0, 0])), 0, atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_many_leaning_boxes_are_counted_one_by_one(seed: int) -> None:
    """Twelve boxes that lean up to 0.6 rad, 2000 points among them."""
    rng = np.random.default_rng(seed)
    boxes = np.column_stack([rng.uniform(-15, 15, (12, 2)), rng.uniform(-2, 2, 12), rng.uniform(2, 5, (12, 3))])
    boxes = np.column_stack([boxes, rng.uniform(-3, 3, 12)])
    leans = rng.uniform(-0.6, 0.6, (12, 2))
    points = rng.normal(boxes[rng.integers(0, 12, 2000), :3], 1.6).astype(np.float32)
    expected = []
    for (*middle, length, width, height, yaw), (roll, pitch) in zip(boxes.tolist(), leans.tolist(), strict=True):
        box_T_world = np.linalg.inv(matrix(quaternion(yaw, pitch, roll), middle))
        own = [box_T_world @ [*point, 1.0] for point in points.tolist()]
        expected.append(
            sum(
                abs(x) <= length / 2 + 0.05
                and abs(y) <= width / 2 + 0.05
                and 0.1 - height / 2 <= z <= height / 2 + 0.05
                for x, y, z, _ in own
            )
        )
    assert min(expected) > 20
    assert tilt.count_returns(points, boxes, leans).tolist() == expected
    assert not tilt.count_returns(points[:0], boxes, leans).any() and not len(
        tilt.count_returns(points, boxes[:0], leans[:0])
    )


def test_an_upright_vehicle_is_counted_as_before(tmp_path: Path) -> None:
    """What leans less than 5 mrad stands upright; there both counts agree."""
    rng = np.random.default_rng(0)
    boxes = np.array([[3.0, 1.0, 0.7, 4.4, 1.8, 1.4, 0.3], [-6.0, 2.0, 0.8, 4.0, 2.0, 1.6, 2.0]])
    points = rng.normal(boxes[rng.integers(0, 2, 500), :3], 1.0).astype(np.float32)
    upright = count_upright(points, boxes)
    assert upright.min() > 40
    assert tilt.count_returns(points, boxes, np.zeros((2, 2))).tolist() == upright.tolist()
    assert tilt.leaning(np.array([[0.004, 0], [0, -0.006], [np.nan, np.nan]])).tolist() == [1]


def test_a_road_under_a_slope_is_no_return(tmp_path: Path) -> None:
    """By hand: a car on a slope of 6°, 4 m long: its road rises by 0.42 m under it, and counts in an upright box."""
    slope = math.radians(6.0)
    along = np.linspace(-1.9, 1.9, 20)
    road = np.stack([along * math.cos(slope), 0 * along, along * math.sin(slope)], axis=1)
    middle = 0.75 * np.array([-math.sin(slope), 0, math.cos(slope)])  # 0.75 m over the road, along the car's z
    box = np.array([[*middle, 4.0, 2.0, 1.5, 0.0]])
    leaning = np.array([[0.0, -slope]])  # the nose is up
    assert count_upright(road, box)[0] >= 5
    assert tilt.count_returns(road, box, leaning).tolist() == [0]
    assert tilt.count_returns(road + 2 * middle, box, leaning).tolist() == [20], "the roof"
    assert_allclose(tilt.foot(box, leaning), [0.0], atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_attitude_is_the_twins(seed: int) -> None:
    yaw, pitch, roll = np.random.default_rng(seed).uniform([-3, -1, -1], [3, 1, 1])
    turned = matrix(quaternion(yaw, pitch, roll), [0.0, 0.0, 0.0])[:3, :3]
    assert_allclose(tilt.attitude(turned), [yaw, roll, pitch], atol=1e-9)
    assert_allclose(tilt.world_R_box(yaw, roll, pitch), turned, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_level_boxes_come_back_from_a_leaning_sensor(seed: int) -> None:
    """coperception's files give x, y and heading in the sensor's frame; a level car stands where it stood."""
    rng = np.random.default_rng(seed)
    world_T_sensor = matrix(quaternion(rng.uniform(-3, 3), *rng.uniform(-0.1, 0.1, 2)), [4.0, -7.0, -4.2])
    ground = -1.8
    road = (world_T_sensor @ [0.0, 0.0, ground, 1.0])[2]
    cars = np.column_stack([rng.uniform(-25, 25, (6, 2)), np.full((6, 2), [4.5, 1.9]), rng.uniform(-3, 3, 6)])
    seen = []
    for x, y, length, width, yaw in cars:
        sensor_T_car = np.linalg.inv(world_T_sensor) @ matrix(quaternion(yaw, 0, 0), [x, y, road + HEIGHT / 2])
        seen.append([*sensor_T_car[:2, 3], length, width, math.atan2(sensor_T_car[1, 0], sensor_T_car[0, 0])])
    back = in_world(np.array(seen), world_T_sensor[:3], ground)
    assert_allclose(back[:, :4], cars[:, :4], atol=1e-9)
    assert_allclose(np.sin(back[:, 4] - cars[:, 4]), 0, atol=1e-9)
    flat = in_world(np.array(seen), np.array([[1.0, 0, 0, 4], [0, 1, 0, -7], [0, 0, 1, -4.2]]), ground)
    assert_allclose(flat[:, :2], np.array(seen)[:, :2] + [4, -7], atol=1e-12)


def planar_error(pitch: float, ahead: float, z: float) -> tuple[float, float]:
    """How far a point of a pitched sender is put wrong by a warp in the plane; m.

    Args:
        pitch: of the sender against the receiver; rad.
        ahead: x of the point in the sender's frame; m.
        z: height over the sender's sensor; m.

    Returns:
        With the upper left part of the 4 × 4 matrix, as coperception warps, and with x, y, yaw alone.
    """
    receiver_T_sender = matrix(quaternion(0.7, pitch, 0.0), [5.0, -3.0, 0.0])
    point = np.array([ahead, 2.0, z, 1.0])
    exact = (receiver_T_sender @ point)[:2]
    cut = receiver_T_sender[:2, :2] @ point[:2] + receiver_T_sender[:2, 3]
    rigid = matrix(quaternion(0.7, 0.0, 0.0), [5.0, -3.0, 0.0])[:2] @ point
    return float(np.hypot(*(exact - cut))), float(np.hypot(*(exact - rigid)))


def test_what_a_planar_warp_is_wrong_by(tmp_path: Path) -> None:
    """Cut from the matrix: sin(pitch) · |z|. With x, y, yaw: also x · (1 - cos(pitch)). Through the chain: nothing."""
    print("\n pitch   4 × 4 cut to the plane   x, y, yaw alone at 30 m   the whole chain")
    for degrees in (1.0, 2.0, 3.0, 5.0, 8.0):
        pitch = math.radians(degrees)
        cut, rigid = planar_error(pitch, 30.0, -1.8)
        print(f"  {degrees:.0f}°       {100 * cut:6.1f} cm              {100 * rigid:6.1f} cm             0")
        assert_allclose(cut, 1.8 * math.sin(pitch), atol=1e-12)
        assert_allclose(rigid, abs(30 * (1 - math.cos(pitch)) + 1.8 * math.sin(pitch)), atol=1e-12)
    assert planar_error(math.radians(8.0), 30.0, 0.0)[0] == pytest.approx(0), "at the sensor's height nothing is lost"
    root, made = leaning_set(tmp_path, 3)
    source = V2XSim(root, progress=False)
    ((sweep,),) = source.sweeps(source.load("hand_7"), [0])
    worlds = np.array([(made["world_T_sensor"] @ [*point, 1.0])[:2] for point in made["points"]])
    away = np.hypot(*(sweep.points[:, None, :2] + sweep.origin[:2] - worlds[None]).T)
    assert away.min(axis=0).max() < 1e-4
