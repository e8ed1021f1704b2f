"""V2X-Real: one vehicle and one unit by hand, classes, `.bin` sweeps, and what is written comes back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from cp_env.scenes import open_source
from cp_env.scenes.errors import BrokenData
from cp_env.scenes.opv2v.v2x_real import V2XReal
from cp_env.scenes.opv2v.writer import write
from cp_env.testing import check_scenes
from tests.helpers.toy_scenes import ToySource

NAME = "2023-03-17-15-53-02_1_0"


def box(x: float, y: float, yaw: float, kind: str | None) -> dict[str, Any]:
    listed = {"angle": [0.0, yaw, 0.0], "center": [0.0, 0.0, 0.0], "extent": [2.0, 1.0, 0.75], "location": [x, y, 0.75]}
    return {**listed, "obj_type": kind} if kind else listed


def write_frame(folder: Path, number: int, lidar: list[float], vehicles: dict[int, Any], points: list[Any]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    said = {"infra": int(folder.name) < 0, "lidar_pose": lidar, "true_ego_pose": lidar, "vehicles": vehicles}
    (folder / f"{number:06d}.yaml").write_text(yaml.safe_dump(said))
    rows = np.column_stack([np.array(points, dtype="<f4"), np.full(len(points), 7, dtype="<f4")])
    (folder / f"{number:06d}.bin").write_bytes(rows.astype("<f4").tobytes())


def write_drive(root: Path, *, frames: int = 4) -> Path:
    """The ego's sensor is 2 m over (10 + k, 20) and faces north; a unit 6 m over the origin faces east and sees the
    ego (33), a bus (1), a pedestrian (2) and a bin (3); the ego sees the bus too."""
    folder = root / NAME
    for k in range(frames):
        bus = {1: box(10 + k, 40, 90, "BUS")}
        write_frame(folder / "1", k, [10 + k, 20, 2, 0, 90, 0], bus, [[20, 0.5, -1], [3, 3, -2]])
        seen = {**bus, 33: box(10 + k, 20.4, 90, "Car"), 2: box(5, 5, 0, "Child"), 3: box(6, 0, 0, "TrashCan")}
        write_frame(folder / "-1", k, [0, 0, 6, 0, 0, 0], seen, [[10 + k, 40, -5], [np.nan, 0, 0], [5, 5, -5.5]])
        write_frame(folder / "-2", k, [0, 0, 6, 0, 0, 0], {}, [[1, 1, -6]])
    return folder


def test_a_vehicle_and_a_unit_by_hand(tmp_path: Path) -> None:
    write_drive(tmp_path / "test")
    source = open_source(f"v2x-real:{tmp_path}?split=test&stride=1")
    scene = source.load(NAME)
    assert scene.dt == pytest.approx(0.1) and scene.connected.tolist() == [0]
    assert scene.rsu is not None and np.allclose(scene.rsu, [0, 0, 6])
    assert np.allclose(scene.pose[3], [[13, 20.4, np.pi / 2], [13, 40, np.pi / 2]]), (
        "the ego, found by its place; the bus"
    )
    ego, unit = source.sweeps(scene, [1])[0]
    assert np.allclose(ego.origin, [11, 20.4, 2]) and np.allclose(unit.origin, [0, 0, 6])
    assert np.allclose(ego.points, [[-0.5, 19.6, 1], [-3, 2.6, 0]], atol=1e-5), "y is to the left"
    assert np.allclose(unit.points, [[11, 40, 1], [5, 5, 0.5]], atol=1e-5), "what is no number is no return"
    assert ego.hits is not None and ego.hits.tolist() == [0, 1]
    assert unit.hits is not None and unit.hits.tolist() == [0, 1]


def test_classes_are_chosen_by_group_and_by_type(tmp_path: Path) -> None:
    write_drive(tmp_path)
    for classes, kinds in (
        ("vehicle", ("Car", "BUS")),
        ("vehicle,pedestrian", ("Car", "BUS", "Child")),
        ("vehicle,-bus", ("Car",)),
        ("trashcan", ("Car", "TrashCan")),
    ):
        source = open_source(f"v2x-real:{tmp_path}?classes={classes}")
        assert isinstance(source, V2XReal) and source.classes(source.load(NAME)) == kinds


def test_units_alone_are_no_scenario_of_ours(tmp_path: Path) -> None:
    write_drive(tmp_path)
    alone = tmp_path / "2023-04-07-14-47-37_17_1"
    write_frame(alone / "-1", 0, [0, 0, 6, 0, 0, 0], {}, [[1, 1, -6]])
    assert V2XReal(tmp_path).names() == (NAME,)
    assert V2XReal(tmp_path, rsu=False).load(NAME).rsu is None


def test_a_sweep_cut_short_and_one_missing_are_named(tmp_path: Path) -> None:
    """The set that is handed out lacks files (V2X-Real's issues 6 and 12)."""
    folder = write_drive(tmp_path, frames=6)
    cut = folder / "1" / "000002.bin"
    cut.write_bytes(cut.read_bytes()[:-3])
    source = V2XReal(tmp_path, stride=1)
    with pytest.raises(BrokenData, match=r"000002\.bin: is cut short: 29 bytes"):
        source.sweeps(source.load(NAME), [2])
    (folder / "-1" / "000004.bin").unlink()
    with pytest.raises(BrokenData, match=r"-1.000004\.bin: is missing"):
        V2XReal(tmp_path)
    kept = V2XReal(tmp_path, stride=1, skip_broken=True)
    assert kept.names() == tuple(f"{NAME}@00000{k}" for k in (0, 3, 5))


def test_what_is_written_comes_back(tmp_path: Path) -> None:
    town = ToySource(n_frames=2, n_connected=3)
    write(town, town.names(), tmp_path, kind="v2x-real")
    source = V2XReal(tmp_path)
    check_scenes(source)
    for name in town.names():
        scene, back = town.load(name), source.load(name)
        assert back.dt == pytest.approx(scene.dt) and np.abs(back.pose[..., :2] - scene.pose[..., :2]).max() < 1e-3
        assert back.rsu is not None and scene.rsu is not None and np.abs(back.rsu - scene.rsu).max() < 1e-3
        for told, wanted in zip(source.sweeps(back, range(2)), town.sweeps(scene, range(2)), strict=True):
            for one, other in zip(told, wanted, strict=True):
                assert one.points.shape == other.points.shape and np.abs(one.points - other.points).max() < 1e-3
