"""V2V4Real: two agents by hand, poses as numpy arrays, boxes in each agent's frame, and what is written comes back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from cp_env.scenes import open_source
from cp_env.scenes.errors import BrokenData
from cp_env.scenes.formats import pcd
from cp_env.scenes.opv2v.v2v4real import V2V4Real
from cp_env.scenes.opv2v.writer import write
from cp_env.testing import check_scenes
from tests.helpers.toy_scenes import ToySource

NAME = "testoutput_CAV_data_2022-03-15-09-54-40_0"


def pose(x: float, y: float, z: float, degrees: float) -> np.ndarray:
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, z], [0, 0, 0, 1]])


def car(x: float, y: float, z: float, yaw: float, ass_id: int = -1, kind: str = "Car") -> dict[str, Any]:
    return {
        "angle": [0.0, yaw, 0.0],
        "ass_id": ass_id,
        "center": [0.0, 0.0, 0.0],
        "extent": [2.0, 1.0, 0.75],
        "location": [x, y, z],
        "obj_type": kind,
    }


def write_agent(folder: Path, number: int, said: dict[str, Any], points: list[list[float]]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{number:06d}.yaml").write_text(yaml.dump({"ego_speed": 0.0, **said}))
    pcd.write(folder / f"{number:06d}.pcd", np.array(points, dtype=np.float32))


def write_drive(root: Path, *, frames: int = 4, degrees: bool = False, meeting: bool = True) -> Path:
    """The road is 10 m up. The ego's sensor is at (100 + k, 50, 12) and faces east, the partner's stands at
    (120, 50, 12) and faces north, to the ego's left; a van at (110, 58), facing west, is seen by both."""
    folder = root / NAME
    unit = 180 / np.pi if degrees else 1.0
    for k in range(frames):
        ego, partner = pose(100 + k, 50, 12, 0), pose(120, 50, 12, 90)
        seen = {5: car(10 - k, 8, -1.25, np.pi * unit)}
        if meeting:
            seen[2] = car(
                20.5 - k, 0, -1.25, np.pi / 2 * unit
            )  # the partner: its sensor stands half a metre to its side
        seen[9] = car(4, -4, -1.2, 0.0, kind="Pedestrian")
        write_agent(folder / "0", k, {"lidar_pose": ego, "true_ego_pose": ego, "vehicles": seen}, [[9 - k, 8, -1.0]])
        listed = {7: car(8, 10, -1.25, np.pi / 2 * unit, ass_id=5), 5: car(-20, 3, -1.25, 0.0)}
        said = {"lidar_pose": partner, "true_ego_pose": partner, "vehicles": listed}
        write_agent(folder / "1", k, said, [[8.5, 10, -0.5], [0, 20, -2]])
    return folder


@pytest.mark.parametrize("degrees", [False, True])
def test_two_agents_by_hand(degrees: bool, tmp_path: Path) -> None:
    write_drive(tmp_path / "test", degrees=degrees)
    source = open_source(f"v2v4real:{tmp_path}?split=test&stride=1")
    assert source.name == "v2v4real/test" and source.names() == (NAME,)
    scene = source.load(NAME)
    assert scene.dt == pytest.approx(0.1) and scene.rsu is None and scene.connected.tolist() == [0, 1]
    # rows: the ego, the partner, the shared van (5 of the ego), what only the partner sees (5 of its own)
    assert len(scene.size) == 4 and np.allclose(scene.size[2], [4.0, 2.0, 1.5])
    assert np.allclose(scene.pose[2, 0], [102, 50, 0]), "nobody lists the ego: it stands under its sensor"
    assert np.allclose(scene.pose[:, 1], [120.5, 50, np.pi / 2]), "the ego's 2 is the partner"
    assert np.allclose(scene.pose[:, 2, :2], [110, 58]) and np.allclose(np.cos(scene.pose[:, 2, 2]), -1)
    assert np.allclose(scene.pose[:, 3], [117, 30, np.pi / 2])
    ego, partner = source.sweeps(scene, [1])[0]
    assert np.allclose(ego.origin, [101, 50, 2.0]) and np.allclose(partner.origin, [120.5, 50, 2.0])
    assert (
        np.allclose(ego.points, [[8, 8, 1.0]], atol=1e-5) and ego.hits is not None and ego.hits.tolist() == [0, 0, 1, 0]
    )
    assert np.allclose(partner.points, [[-10.5, 8.5, 1.5], [-20.5, 0, 0]], atol=1e-5)
    assert partner.hits is not None and partner.hits.tolist() == [0, 0, 1, 0]


def test_a_partner_that_is_not_always_met_stands_to_its_sensor_as_elsewhere(tmp_path: Path) -> None:
    folder = write_drive(tmp_path)
    for number in (0, 2):
        file = folder / "0" / f"{number:06d}.yaml"
        said = yaml.unsafe_load(file.read_text())
        del said["vehicles"][2]
        file.write_text(yaml.dump(said))
    scene = V2V4Real(tmp_path, stride=1).load(NAME)
    assert len(scene.size) == 4 and np.allclose(scene.pose[:, 1], [120.5, 50, np.pi / 2])


def test_a_partner_that_is_never_met_is_of_a_usual_size(tmp_path: Path) -> None:
    write_drive(tmp_path, meeting=False)
    scene = V2V4Real(tmp_path, stride=1).load(NAME)
    assert np.allclose(scene.pose[:, 1], [120, 50, np.pi / 2]) and np.allclose(scene.size[1], [4.9, 2.12, 1.5])


def test_classes_and_angles_are_chosen(tmp_path: Path) -> None:
    write_drive(tmp_path)
    source = V2V4Real(tmp_path, classes=("vehicle", "pedestrian"))
    scene = source.load(NAME)
    assert scene.dt == pytest.approx(0.2) and len(scene.size) == 5
    assert source.classes(scene) == ("vehicle", "Car", "Car", "Pedestrian", "Car")
    degrees = V2V4Real(tmp_path, angles="degrees").load(NAME)
    assert degrees.pose[0, 2, 2] == pytest.approx(np.deg2rad(np.pi))
    with pytest.raises(ValueError, match="angles must be one of auto, degrees, radians"):
        V2V4Real(tmp_path, angles="grad")


@pytest.mark.parametrize(
    ("matrix", "told"),
    [
        (2 * np.eye(4), "no rigid motion"),
        (np.diag([1.0, -1.0, 1.0, 1.0]), "no rigid motion"),
        (np.full((4, 4), np.nan), "4 × 4 finite numbers"),
        (np.eye(4)[:3], "must be 6 finite numbers"),
    ],
)
def test_bad_matrices_are_named(matrix: np.ndarray, told: str, tmp_path: Path) -> None:
    folder = write_drive(tmp_path)
    (folder / "1" / "000002.yaml").write_text(yaml.dump({"lidar_pose": matrix, "vehicles": {}}))
    with pytest.raises(BrokenData, match=rf"1.000002\.yaml: lidar_pose .*{told}"):
        V2V4Real(tmp_path, stride=1).load(NAME)


def test_arrays_are_read_that_other_keys_name(tmp_path: Path) -> None:
    """PyYAML names numpy's types where it meets them first: in a key that is not read, beside what nobody may read."""
    folder = write_drive(tmp_path)
    plain = V2V4Real(tmp_path, stride=1).load(NAME)
    for file in folder.glob("*/*.yaml"):
        said = yaml.unsafe_load(file.read_text())
        text = yaml.dump({"gps": np.arange(3.0), **said, "zone": 1})
        assert text.index("&id001") < text.index("lidar_pose") < text.index("*id001")
        file.write_text(f"camera: !!python/object:builtins.object {{}}\n{text}")
    assert np.allclose(V2V4Real(tmp_path, stride=1).load(NAME).pose, plain.pose)


def test_what_is_written_comes_back(tmp_path: Path) -> None:
    """Two connected vehicles of a crossing, in the frame of whoever sees them, to a millimetre."""
    town = ToySource(n_frames=3, n_connected=2, rsu=False)
    write(town, town.names(), tmp_path, kind="v2v4real")
    source = V2V4Real(tmp_path)
    check_scenes(source)
    for name in town.names():
        scene, back = town.load(name), source.load(name)
        assert back.dt == pytest.approx(scene.dt) and np.abs(back.pose[..., :2] - scene.pose[..., :2]).max() < 1e-3
        assert np.allclose(np.exp(1j * back.pose[..., 2]), np.exp(1j * scene.pose[..., 2]), atol=1e-6)
        assert np.allclose(back.size, scene.size)
        for told, wanted in zip(source.sweeps(back, range(3)), town.sweeps(scene, range(3)), strict=True):
            for one, other in zip(told, wanted, strict=True):
                assert one.points.shape == other.points.shape and np.abs(one.points - other.points).max() < 1e-3
                assert np.abs(one.origin - other.origin).max() < 1e-3
