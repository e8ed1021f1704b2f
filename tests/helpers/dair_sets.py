"""Small sets in the layout of DAIR-V2X-C: any source's scenes, each a batch, and a crossing worked out by hand.

It shares nothing with the reader: calibrations are made by 4 × 4 matrices of its own, corners one by one, points by
`struct`. The vehicle's receiver is turned by 90° against its LiDAR, as on the data set's own car; the unit's virtual
LiDAR is turned by 0.5 rad. The unit's calibration is wrong by what the offset mends. The ground is 20 m up.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cp_env.types import Scene, SceneSource

GROUND = 20.0
OFFSET = (0.7, -0.4)  # m
QUARTER = math.pi / 2


def pose(x: float, y: float, z: float, yaw: float) -> np.ndarray:
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, z], [0, 0, 0, 1]])


def corners(box: Sequence[float]) -> list[list[float]]:
    """Of x, y, z of the middle, length, width, height, yaw: the floor from front left to the right round, and above."""
    x, y, z, length, width, height, yaw = box
    found = []
    for up in (-1, 1):
        for ahead, left in ((1, 1), (1, -1), (-1, -1), (-1, 1)):
            a, b = ahead * length / 2, left * width / 2
            found.append(
                [
                    x + a * math.cos(yaw) - b * math.sin(yaw),
                    y + a * math.sin(yaw) + b * math.cos(yaw),
                    z + up * height / 2,
                ]
            )
    return found


def write_json(file: Path, said: Any) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(said))


def calibration(matrix: np.ndarray, **more: Any) -> dict[str, Any]:
    return {"rotation": matrix[:3, :3].tolist(), "translation": [[value] for value in matrix[:3, 3].tolist()], **more}


def write_cloud(file: Path, points: Iterable[Sequence[float]]) -> None:
    """Binary PCD with an intensity, as the set has it."""
    file.parent.mkdir(parents=True, exist_ok=True)
    rows = [struct.pack("<4f", *point, 7.0) for point in points]
    head = "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z intensity\nSIZE 4 4 4 4\n"
    head += f"TYPE F F F F\nCOUNT 1 1 1 1\nWIDTH {len(rows)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(rows)}\n"
    file.write_bytes((head + "DATA binary\n").encode() + b"".join(rows))


class Set:
    """A set in the making."""

    def __init__(self, root: Path) -> None:
        self.root = root / "cooperative-vehicle-infrastructure"
        self.pairs: list[dict[str, Any]] = []
        self.frames: dict[str, list[dict[str, Any]]] = {"vehicle-side": [], "infrastructure-side": []}

    def add(
        self,
        number: int,
        batch: str,
        time: int,
        vehicle: np.ndarray,
        unit: np.ndarray,
        boxes: Iterable[tuple[str, Sequence[float]]],
        clouds: tuple[Iterable[Sequence[float]], Iterable[Sequence[float]]],
        *,
        in_pair: bool = True,
    ) -> None:
        """One pair: poses of both LiDARs in the world (4 × 4), boxes there, points in each LiDAR's frame.

        The offset is given with the pair, or else in the unit's calibration.
        """
        name, other = f"{number:06d}", f"{number + 5000:06d}"
        offset = {"delta_x": OFFSET[0], "delta_y": OFFSET[1]}
        sides = {"vehicle": ("vehicle-side", name), "infrastructure": ("infrastructure-side", other)}
        record: dict[str, Any] = {"cooperative_label_path": f"cooperative/label_world/{name}.json"}
        for what, (folder, its) in sides.items():
            record[f"{what}_image_path"] = f"{folder}/image/{its}.jpg"
            record[f"{what}_pointcloud_path"] = f"{folder}/velodyne/{its}.pcd"
            self.frames[folder].append(
                {"pointcloud_path": f"velodyne/{its}.pcd", "batch_id": batch, "pointcloud_timestamp": str(time)}
            )
        record["system_error_offset"] = offset if in_pair else ""
        self.pairs.append(record)
        novatel_T_lidar = pose(0.2, -0.6, -1.1, QUARTER)
        wrong = unit.copy()
        wrong[:2, 3] -= OFFSET
        side = self.root / "vehicle-side/calib"
        write_json(side / f"lidar_to_novatel/{name}.json", {"transform": calibration(novatel_T_lidar)})
        write_json(side / f"novatel_to_world/{name}.json", calibration(vehicle @ np.linalg.inv(novatel_T_lidar)))
        error = {"delta_x": "", "delta_y": ""} if in_pair else offset
        write_json(
            self.root / f"infrastructure-side/calib/virtuallidar_to_world/{other}.json",
            calibration(wrong, relative_error=error),
        )
        label = [
            {"type": kind, "world_8_points": corners(box), "3d_dimensions": {"l": 1, "w": 1, "h": 1}, "rotation": 9}
            for kind, box in boxes
        ]
        write_json(self.root / f"cooperative/label_world/{name}.json", label)
        for (folder, its), points in zip(sides.values(), clouds, strict=True):
            write_cloud(self.root / folder / f"velodyne/{its}.pcd", points)

    def close(self, splits: dict[str, list[str]] | None = None) -> Path:
        write_json(self.root / "cooperative/data_info.json", self.pairs)
        for folder, records in self.frames.items():
            write_json(self.root / folder / "data_info.json", records)
        if splits is not None:
            write_json(self.root.parent / "cooperative-split-data.json", {"cooperative_split": splits})
        return self.root.parent


def write_set(source: SceneSource, root: Path, *, every: int = 1) -> Path:
    """The source's scenes as batches 0, 1, …: the first connected vehicle and the road-side unit; every n-th point.

    Vehicles are labelled in an order that changes from frame to frame, the ego among them in even frames only. The
    first scene is the split `val`, the others are `train`.
    """
    made = Set(root)
    splits: dict[str, list[str]] = {"train": [], "val": [], "test": []}
    for batch, name in enumerate(source.names()):
        scene = source.load(name)
        assert scene.rsu is not None
        for t, sweeps in enumerate(source.sweeps(scene, range(scene.n_frames))):
            number = 1000 * batch + t
            splits["train" if batch else "val"].append(f"{number:06d}")
            lidars = [_lidar(scene, t), pose(*scene.rsu[:2], GROUND + scene.rsu[2], 0.5)]
            places = [(*scene.pose[t, scene.connected[0], :2], GROUND), (*scene.rsu[:2], GROUND)]
            clouds = []
            for lidar, place, sweep in zip(lidars, places, (sweeps[0], sweeps[-1]), strict=True):
                clouds.append(((sweep.points[::every] + place - lidar[:3, 3]) @ lidar[:3, :3]).tolist())
            rows = [
                row for row in np.flatnonzero(~np.isnan(scene.pose[t, :, 0])) if row != scene.connected[0] or t % 2 == 0
            ]
            boxes = [("car", _box(scene, t, int(row))) for row in np.roll(rows, t)]
            time = 1_626_165_000_000_000 + round(1e6 * (1000 * batch + t * scene.dt))
            made.add(number, str(batch), time, lidars[0], lidars[1], boxes, (clouds[0], clouds[1]), in_pair=batch == 0)
    return made.close(splits)


def _lidar(scene: Scene, t: int) -> np.ndarray:
    """The vehicle's LiDAR: 0.3 m ahead of the middle of its box, 1.7 m over the ground."""
    x, y, yaw = scene.pose[t, scene.connected[0]].tolist()
    return pose(x + 0.3 * math.cos(yaw), y + 0.3 * math.sin(yaw), GROUND + 1.7, yaw)


def _box(scene: Scene, t: int, row: int) -> list[float]:
    x, y, yaw = scene.pose[t, row].tolist()
    length, width, height = scene.size[row].tolist()
    return [x, y, GROUND + height / 2, length, width, height, yaw]


def by_hand(root: Path, *, frames: int = 3) -> Path:
    """A batch worked out on paper: the vehicle's LiDAR is 2 m over the ground at (100 + t, 50), and looks east.

    ```
       y ↑                         a van at (112, 58), looks west, 5 × 2 × 2 m
      58 |             ←V
      50 |  L→→                    the vehicle; nobody labels it
      40 |        U                the unit's virtual LiDAR at (110, 40), 6 m up, looks north (to +y)
         +--100--110--112--→ x
    ```
    A point (12 - t, 8, -1) of the vehicle's is the van's middle at half its height, seen by the unit at (18, -2, -5).
    """
    made = Set(root)
    for t in range(frames):
        clouds = [[[12.0 - t, 8, -1], [3, 3, -2], [9, -1, -2]], [[18.0, -2, -5], [1, 1, -6]]]
        boxes = [
            ("van", [112, 58, GROUND + 1, 5, 2, 2, math.pi]),
            ("pedestrian", [105, 45, GROUND + 0.9, 0.6, 0.6, 1.8, 0]),
        ]
        vehicle, unit = pose(100 + t, 50, GROUND + 2, 0), pose(110, 40, GROUND + 6, QUARTER)
        made.add(10 + t, "7", 1_626_165_000_000_000 + 100_000 * t, vehicle, unit, boxes, (clouds[0], clouds[1]))
    return made.close({"train": ["000010"], "val": ["000011", "000012"]})
