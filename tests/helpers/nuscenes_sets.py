"""Small sets in the layout of nuScenes: any source's scenes as one vehicle sees them, and a street worked out by hand.

It shares nothing with the reader: quaternions come from SciPy, poses are 4 × 4 matrices. Ego poses are at the rear
axle, 1.4 m behind the middle of the vehicle, at z = 0; LIDAR_TOP is mounted 0.94 m ahead of it and 1.84 m up, turned by
-90°, so that its x axis looks to the right.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from cp_env.types import SceneSource

VERSION = "v1.0-mini"
MOUNT = (0.94, 0.0, 1.84)
AXLE = 1.4  # m behind the middle
HOURS = 1_531_883_530_000_000  # µs
RIGHT = Rotation.from_euler("z", -90, degrees=True)


def quaternion(yaw: float) -> list[float]:
    x, y, z, w = Rotation.from_euler("z", yaw).as_quat().tolist()
    return [w, x, y, z]


class Set:
    """A set in the making: tables, and files of points."""

    def __init__(self, root: Path, version: str = VERSION) -> None:
        self.root, self.version = root, version
        x, y, z, w = RIGHT.as_quat().tolist()
        self.tables: dict[str, list[dict[str, Any]]] = {
            "scene": [],
            "sample": [],
            "sensor": [
                {"token": "lidar", "channel": "LIDAR_TOP", "modality": "lidar"},
                {"token": "front", "channel": "CAM_FRONT", "modality": "camera"},
            ],
            "calibrated_sensor": [
                {"token": "mount", "sensor_token": "lidar", "translation": list(MOUNT), "rotation": [w, x, y, z]},
                {"token": "camera", "sensor_token": "front", "translation": [1.7, 0, 1.5], "rotation": [1, 0, 0, 0]},
            ],
            "sample_data": [],
            "ego_pose": [],
            "category": [
                {"token": name, "name": name}
                for name in ("vehicle.car", "vehicle.bus.rigid", "human.pedestrian.adult", "vehicle.bicycle")
            ],
            "instance": [],
            "sample_annotation": [],
        }

    def scene(self, name: str, first: str, last: str, count: int) -> None:
        self.tables["scene"].append(
            {
                "token": name,
                "name": name,
                "description": "Night, parked cars",
                "first_sample_token": first,
                "last_sample_token": last,
                "nbr_samples": count,
            }
        )

    def sample(self, token: str, scene: str, after: str, time: int) -> None:
        self.tables["sample"].append({"token": token, "scene_token": scene, "next": after, "timestamp": time})

    def sweep(
        self,
        token: str,
        sample: str,
        middle: Sequence[float],
        points: Iterable[Sequence[float]],
        time: int,
        *,
        key: bool,
    ) -> None:
        """One LiDAR file, points given in the world; `middle` is x, y, yaw of the vehicle's middle."""
        x, y, yaw = middle
        ego = [x - AXLE * math.cos(yaw), y - AXLE * math.sin(yaw), 0.0]
        self.tables["ego_pose"].append(
            {"token": f"pose-{token}", "translation": ego, "rotation": quaternion(yaw), "timestamp": time}
        )
        file = f"{'samples' if key else 'sweeps'}/LIDAR_TOP/{token}.pcd.bin"
        record = {
            "sample_token": sample,
            "ego_pose_token": f"pose-{token}",
            "filename": file,
            "is_key_frame": key,
            "timestamp": time,
        }
        self.tables["sample_data"].append({"token": token, "calibrated_sensor_token": "mount", **record})
        self.tables["sample_data"].append(
            {"token": f"image-{token}", "calibrated_sensor_token": "camera", **record, "filename": "nowhere.jpg"}
        )
        body = (np.array(list(points), dtype=np.float64).reshape(-1, 3) - ego) @ Rotation.from_euler(
            "z", yaw
        ).as_matrix()
        rows = np.zeros((len(body), 5), dtype="<f4")
        rows[:, :3] = (body - MOUNT) @ RIGHT.as_matrix()
        (self.root / file).parent.mkdir(parents=True, exist_ok=True)
        (self.root / file).write_bytes(rows.tobytes())

    def box(self, sample: str, instance: str, category: str, box: Sequence[float]) -> None:
        """x, y, z of the middle, length, width, height, yaw."""
        x, y, z, length, width, height, yaw = box
        if instance not in {record["token"] for record in self.tables["instance"]}:
            self.tables["instance"].append({"token": instance, "category_token": category})
        self.tables["sample_annotation"].append(
            {
                "token": f"{sample}-{instance}",
                "sample_token": sample,
                "instance_token": instance,
                "translation": [x, y, z],
                "size": [width, length, height],
                "rotation": quaternion(yaw),
            }
        )

    def close(self) -> Path:
        folder = self.root / self.version
        folder.mkdir(parents=True, exist_ok=True)
        for name, records in self.tables.items():
            (folder / f"{name}.json").write_text(json.dumps(records))
        return self.root


def write_set(source: SceneSource, root: Path, names: Sequence[str], *, every: int = 1, between: int = 0) -> Path:
    """The source's scenes under other names, as the first connected vehicle sees them.

    Args:
        source: any source whose ground is at z = 0.
        root: a folder.
        names: of the scenes, such as "scene-0061".
        every: only every n-th point is written.
        between: so many of the source's frames lie between keyframes, as sweeps.
    """
    made = Set(root)
    for name, theirs in zip(names, source.names(), strict=True):
        scene = source.load(theirs)
        keys = range(0, scene.n_frames, between + 1)
        tokens = [f"{name}-{t}" for t in keys]
        made.scene(name, tokens[0], tokens[-1], len(tokens))
        ego = int(scene.connected[0])
        for t, sweeps in enumerate(source.sweeps(scene, range(scene.n_frames))):
            key = t % (between + 1) == 0
            sample = f"{name}-{min(-(-t // (between + 1)) * (between + 1), keys[-1])}"
            time = HOURS + round(1e6 * scene.dt * t)
            place = (*scene.pose[t, ego, :2], 0.0)
            points = (sweeps[0].points[::every].astype(np.float64) + place).tolist()
            made.sweep(f"{name}-lidar-{t}", sample, scene.pose[t, ego].tolist(), points, time, key=key)
            if not key:
                continue
            after = f"{name}-{t + between + 1}"
            made.sample(sample, name, after if after in tokens else "", time)
            for row in np.flatnonzero(~np.isnan(scene.pose[t, :, 0])).tolist():
                if row != ego:
                    (x, y, yaw), (length, width, height) = scene.pose[t, row].tolist(), scene.size[row].tolist()
                    made.box(sample, f"{name}-{row}", "vehicle.car", (x, y, height / 2, length, width, height, yaw))
    return made.close()


def by_hand(root: Path) -> Path:
    """Scene 61: two keyframes half a second apart, one sweep between them; the ego drives north (+y) at 10 m/s.

    ```
      y ↑        bus at (-5, 70), looks north, 10 × 3 × 3 m
      55|   E↑   the middle of the ego in the second keyframe, (10, 55); in the first, (10, 50)
        +---10-→ x
    ```
    The LiDAR is 0.46 m behind the middle (1.4 - 0.94): at (10, 49.54, 1.84) and (10, 54.54, 1.84).
    """
    made = Set(root)
    made.scene("scene-0061", "one", "two", 2)
    north = math.pi / 2
    for k, (sample, after) in enumerate((("one", "two"), ("two", ""))):
        made.sample(sample, "scene-0061", after, HOURS + 500_000 * k)
        points = [[-4, 66, 1.0], [12, 60, 0], [10, 50 + 5 * k, 1.5]]
        made.sweep(f"key-{sample}", sample, (10, 50 + 5 * k, north), points, HOURS + 500_000 * k, key=True)
        made.box(sample, "bus", "vehicle.bus.rigid", (-5, 70, 1.5, 10, 3, 3, north))
        made.box(sample, "walker", "human.pedestrian.adult", (15, 60, 0.9, 0.7, 0.7, 1.8, 0))
    own, kerb = [10, 52.5, 1.5], [13, 53, 0.1]
    made.sweep("between", "two", (10, 52.5, north), [own, kerb], HOURS + 250_000, key=False)
    return made.close()
