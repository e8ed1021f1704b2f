"""A scene out of notes: who carries which sensor, the road under it, and what is listed under two numbers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cp_env.geometry.planar import compose
from cp_env.scenes.errors import BrokenData
from cp_env.scenes.opv2v.build import SENSOR, FrameSequence, build
from cp_env.scenes.opv2v.classes import DEFAULT, Choice
from cp_env.scenes.opv2v.files import Note
from cp_env.scenes.opv2v.folders import Scenario
from cp_env.scenes.opv2v.layouts import OPV2V, V2X_REAL

NUMBERS = ("000000", "000002", "000004")
HALF = np.array([2.0, 1.0, 0.75])


def motion(x: float, y: float, z: float, yaw: float) -> np.ndarray:
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, z]])


def note(
    lidar: np.ndarray, boxes: dict[int, tuple[float, float, float, float]], body: np.ndarray | None = None
) -> Note:
    """Boxes by their middle: x, y, z, yaw."""
    count = len(boxes)
    return Note(
        lidar=lidar,
        body=body,
        predicted=None,
        speed=np.nan,
        timestamp=None,
        numbers=tuple(boxes),
        associated=(None,) * count,
        kinds=(None,) * count,
        speeds=np.full(count, np.nan),
        pose=np.array([motion(*place) for place in boxes.values()]).reshape(-1, 3, 4),
        center=np.zeros((count, 3)),
        extent=np.tile(HALF, (count, 1)),
        widest=0.0,
    )


def made(rows: list[list[Note]], rsu: str | None = None, layout: object = V2X_REAL) -> FrameSequence:
    agents = ("1", "2")[: len(rows[0]) - (rsu is not None)]
    scenario = Scenario(Path("drive"), agents, rsu, NUMBERS, 2, dict.fromkeys([*agents, rsu or "-1"], ".pcd"))
    assert layout in (OPV2V, V2X_REAL)
    known = OPV2V if layout is OPV2V else V2X_REAL
    return build(scenario, NUMBERS, rows, known, Choice.of(DEFAULT), 0.2, "drive")


def test_a_carrier_that_is_tracked_under_two_numbers_is_one_vehicle() -> None:
    """The unit loses the ego (7) and finds it again (8); in between it stands to its sensor as it mostly does."""
    unit = motion(0, 0, 6, 0)
    ego = [motion(10 + k, 5, 1.8, 0.1) for k in range(3)]
    seen = [tuple(compose(np.array([10.0 + k, 5, 0.1]), np.array([0.6, -0.2, 0.02]))) for k in range(3)]
    boxes = [{7 + k // 2: (x, y, 0.75, yaw)} for k, (x, y, yaw) in enumerate(seen)]
    boxes[1] = {}
    scene = made([[note(ego[k], {}), note(unit, boxes[k])] for k in range(3)], rsu="-1").scene
    assert len(scene.size) == 1 and np.allclose(scene.pose[:, 0], seen)


def test_who_passes_close_by_carries_nothing() -> None:
    """Vehicle 3 overtakes the ego's sensor by 2.2 m at its side: never under it."""
    rows = [[note(motion(10, 0, 2, 0), {3: (4.0 + 6 * k, 2.2, 0.75, 0.0)})] for k in range(3)]
    assert len(made(rows).scene.size) == 2


def test_the_road_is_at_the_bottom_of_boxes_near_a_sensor() -> None:
    """2 m under it by the median of three, whatever a far one says; and by default where there is none."""
    heights = [-1.25, -1.05, -1.25]
    rows = [[note(motion(10, 0, 12, 0), {3: (18, 0, 12 + h, 0), 4: (90, 0, 30, 0)})] for h in heights]
    made_here = made(rows)
    assert np.allclose(made_here.ground[:, 0], 10.0)
    alone = made([[note(motion(10, 0, 12, 0), {})] for _ in range(3)])
    assert np.allclose(alone.ground, 12 - SENSOR) and len(alone.scene.size) == 1


def test_the_first_agent_says_where_a_vehicle_is() -> None:
    rows = [[note(motion(0, 0, 2, 0), {9: (20, 0, 0.75, 0)}), note(motion(0, 40, 2, 0), {9: (21, 0, 0.75, 0)})]] * 3
    rows = [*rows[:2], [replace(rows[2][0], numbers=(8,)), rows[2][1]]]
    pose = made(rows).scene.pose
    assert np.allclose(pose[:, 3, 0], [20, 20, 21]) and np.isnan(pose[:2, 2, 0]).all() and pose[2, 2, 0] == 20


def test_a_vehicle_of_opv2v_needs_a_place() -> None:
    rows = [[note(motion(0, 0, 2, 0), {}, body=motion(0, 0, 0, 0) if k else None)] for k in range(3)]
    with pytest.raises(BrokenData, match=r"000000\.yaml: lacks true_ego_pos, no other agent lists it"):
        made(rows, layout=OPV2V)


def test_an_unknown_class_names_its_file() -> None:
    bad = replace(note(motion(0, 0, 2, 0), {9: (20, 0, 0.75, 0)}), kinds=("Zeppelin",))
    with pytest.raises(BrokenData, match=r"000004\.yaml: vehicle 9: .*Zeppelin.*classes=vehicle,zeppelin"):
        made([[note(motion(0, 0, 2, 0), {})], [note(motion(0, 0, 2, 0), {})], [bad]])
