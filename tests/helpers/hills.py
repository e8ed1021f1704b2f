"""Flat sets put on a hill: every file of an exported set is lifted and leaned, by matrices of its own.

The hill rises by 7 % to the east and curves in y. A body at (x, y) stands on it at `height(x, y)`, its z axis along the
hill's normal, its x axis above its heading. Points stay as high over the hill, along its normal under them.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from cp_env.scenes.formats import pcd

MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])


def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.asarray(0.07 * x + 1.5 * (1 - np.cos(y / 25)))


def _axes(x: float, y: float, yaw: float) -> np.ndarray:
    """The rotation of a body that stands on the hill."""
    slope = np.array([0.07, 1.5 / 25 * np.sin(y / 25)])
    ahead = np.array([np.cos(yaw), np.sin(yaw)])
    forward = np.array([*ahead, slope @ ahead])
    up = np.array([*-slope, 1.0])
    forward, up = forward / np.linalg.norm(forward), up / np.linalg.norm(up)
    return np.stack([forward, np.cross(up, forward), up], axis=1)


def lifted(pose: np.ndarray) -> np.ndarray:
    """An upright body's 4 × 4 pose on flat ground, on the hill: as high over the road, along the hill's normal."""
    x, y, z = pose[:3, 3]
    turn = _axes(x, y, np.arctan2(pose[1, 0], pose[0, 0]))
    made = np.eye(4)
    made[:3, :3] = turn
    made[:3, 3] = np.array([x, y, float(height(x, y))]) + z * turn[:, 2]
    return made


def moved(points: np.ndarray, flat: np.ndarray, hilly: np.ndarray) -> np.ndarray:
    """Points of a sensor's frame on flat ground, in the frame it has on the hill."""
    x, y, z = (points @ flat[:3, :3].T + flat[:3, 3]).T
    up = np.stack([np.full_like(x, -0.07), -1.5 / 25 * np.sin(y / 25), np.ones_like(x)], axis=1)
    world = np.stack([x, y, height(x, y)], axis=1) + z[:, None] * up / np.linalg.norm(up, axis=1, keepdims=True)
    return np.asarray((world - hilly[:3, 3]) @ hilly[:3, :3])


def _of_carla(pose: list[float]) -> np.ndarray:
    """Ours of an upright CARLA pose (x, y, z, roll, yaw, pitch)."""
    x, y, z, _, yaw, _ = pose
    made = np.eye(4)
    made[:3, :3] = Rotation.from_euler("z", -yaw, degrees=True).as_matrix()
    made[:3, 3] = x, -y, z
    return made


def _to_carla(pose: np.ndarray) -> list[float]:
    """CARLA's pose of ours: its matrix is ours with y mirrored on both sides."""
    matrix = MIRROR @ pose @ MIRROR
    pitch = np.arcsin(matrix[2, 0])
    yaw, roll = np.arctan2(matrix[1, 0], matrix[0, 0]), np.arctan2(-matrix[2, 1], matrix[2, 2])
    return [*matrix[:3, 3].tolist(), *np.rad2deg([roll, yaw, pitch]).tolist()]


def lift_opv2v(root: Path) -> Path:
    """Every scenario in a folder of OPV2V's layout."""
    for file in sorted(root.glob("*/*/*.yaml")):
        said = yaml.safe_load(file.read_text())
        for entry in said["vehicles"].values():
            pose = lifted(_of_carla([*entry["location"], *entry["angle"]]))
            entry["location"], entry["angle"] = np.split(np.array(_to_carla(pose)), 2)
            entry["location"], entry["angle"] = entry["location"].tolist(), entry["angle"].tolist()
        lidar = _of_carla(said["lidar_pose"])
        for key in ("true_ego_pos", "predicted_ego_pos"):
            said[key] = _to_carla(lifted(_of_carla(said[key])))
        said["lidar_pose"] = _to_carla(lifted(lidar))
        cloud = file.with_suffix(".pcd")
        points = pcd.read(cloud).astype(np.float64) * [1, -1, 1]
        pcd.write(cloud, moved(points, lidar, lifted(lidar)) * [1, -1, 1])
        file.write_text(yaml.safe_dump(said))
    return root


def lift_v2x_sim(root: Path) -> Path:
    """A set in V2X-Sim's layout, whose LiDARs stand upright over their ego poses."""
    tables = {name: json.loads((root / "v2.0" / f"{name}.json").read_text()) for name in ("ego_pose", "sample_data")}
    boxes = json.loads((root / "v2.0/sample_annotation.json").read_text())
    mounts = {one["token"]: one for one in json.loads((root / "v2.0/calibrated_sensor.json").read_text())}
    poses = {one["token"]: one for one in tables["ego_pose"]}
    for shot in tables["sample_data"]:
        ego, mount = (
            _of_quaternion(poses[shot["ego_pose_token"]]),
            _of_quaternion(mounts[shot["calibrated_sensor_token"]]),
        )
        file = root / shot["filename"]
        rows = np.fromfile(file, dtype=np.float32).reshape(-1, 5)
        rows[:, :3] = moved(rows[:, :3].astype(np.float64), ego @ mount, lifted(ego) @ mount)
        rows.tofile(file)
    for one in poses.values():
        _lean(one, lifted(_of_quaternion(one)))
    for one in boxes:
        _lean(one, lifted(_of_quaternion(one)))
    (root / "v2.0/ego_pose.json").write_text(json.dumps(tables["ego_pose"]))
    (root / "v2.0/sample_annotation.json").write_text(json.dumps(boxes))
    return root


def _of_quaternion(record: dict[str, list[float]]) -> np.ndarray:
    made = np.eye(4)
    made[:3, :3] = Rotation.from_quat(np.roll(record["rotation"], -1)).as_matrix()
    made[:3, 3] = record["translation"]
    return made


def _lean(record: dict[str, list[float]], pose: np.ndarray) -> None:
    record["rotation"] = np.roll(Rotation.from_matrix(pose[:3, :3]).as_quat(), 1).tolist()
    record["translation"] = pose[:3, 3].tolist()
