"""Small V2X-Sim sets for tests: exported miniatures, tables written by hand, and ways to damage them."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cp_env.scenes.export import export
from cp_env.types import Scene, Sweep
from tests.helpers.toy_scenes import ToySource, toy_scene


class Thin:
    """A source with every n-th point of its sweeps only: small files."""

    def __init__(self, source: ToySource, every: int) -> None:
        self.name, self.digest = source.name, f"{source.digest}-{every}"
        self._source, self._every = source, every

    def names(self) -> tuple[str, ...]:
        return self._source.names()

    def load(self, name: str) -> Scene:
        return self._source.load(name)

    def sweeps(self, scene: Scene, frames: Sequence[int]) -> list[list[Sweep]]:
        taken = self._source.sweeps(scene, frames)
        return [[replace(sweep, points=sweep.points[:: self._every]) for sweep in row] for row in taken]


class Numbered(ToySource):
    """Toy crossings with the numbers of a training, a validation and a test scene."""

    def __init__(self, n_frames: int) -> None:
        super().__init__(n_frames=n_frames)
        self._scenes = {name: toy_scene(name=name, n_frames=n_frames) for name in ("scene_0", "scene_1", "scene_5")}


def thin_set(root: Path, *, n_frames: int = 2, n_connected: int = 2) -> Path:
    """Two toy crossings of a few hundred points, exported."""
    return export(Thin(ToySource(n_frames=n_frames, n_connected=n_connected), 100), root)


def edit(root: Path, table: str, change: Callable[[list[dict[str, Any]]], Any]) -> None:
    """Change the records of a table in place."""
    path = root / "v2.0" / f"{table}.json"
    records = json.loads(path.read_text())
    change(records)
    path.write_text(json.dumps(records))


def hand_made(root: Path, points: Sequence[tuple[float, float, float]]) -> Path:
    """One frame: a vehicle that looks north (+y), its LiDAR 1 m ahead and 2 m up, turned to the right; one other car.

    ```
      y ↑            other car at (13, 25), looks east
      25|    +--->
        |
      21|  L →       the LiDAR looks east: 90° to the left (the vehicle), then 90° to the right (the mount)
      20|  V ↑       the vehicle's middle at (10, 20), its foot at z = 5.1, the other's at 5
        +--10--13--→ x
    ```
    """
    quarter = [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]
    back = [np.sqrt(0.5), 0.0, 0.0, -np.sqrt(0.5)]
    tables: dict[str, list[dict[str, Any]]] = {
        "scene": [{"token": "s", "name": "hand_7", "description": "urban", "first_sample_token": "f"}],
        "sample": [{"token": "f", "scene_token": "s", "next": "", "timestamp": 1_000_000}],
        "sensor": [{"token": "l", "channel": "LIDAR_TOP_id_1"}, {"token": "c", "channel": "CAM_FRONT_id_1"}],
        "calibrated_sensor": [
            {"token": "m", "sensor_token": "l", "translation": [1.0, 0.0, 2.0], "rotation": back},
            {"token": "n", "sensor_token": "c", "translation": [1.0, 0.0, 2.0], "rotation": back},
        ],
        "ego_pose": [{"token": "e", "translation": [10.0, 20.0, 5.1], "rotation": quarter}],
        "sample_data": [
            {
                "token": token,
                "sample_token": "f",
                "calibrated_sensor_token": mount,
                "ego_pose_token": "e",
                "filename": file,
                "is_key_frame": True,
            }
            for token, mount, file in (("d", "m", "sweeps/LIDAR_TOP_id_1/a.pcd.bin"), ("p", "n", "sweeps/missing.png"))
        ],
        "category": [{"token": "k", "name": "vehicle.car"}, {"token": "h", "name": "human.pedestrian.adult"}],
        "instance": [
            {"token": token, "category_token": category} for token, category in (("i", "k"), ("j", "k"), ("w", "h"))
        ],
        "sample_annotation": [
            {
                "token": instance + "0",
                "sample_token": "f",
                "instance_token": instance,
                "translation": middle,
                "size": [2.0, 4.0, 1.5],
                "rotation": turn,
            }
            for instance, middle, turn in (
                ("i", [10.0, 20.0, 5.85], quarter),
                ("j", [13.0, 25.0, 5.75], [1.0, 0.0, 0.0, 0.0]),
                ("w", [15.0, 25.0, 5.9], [1.0, 0.0, 0.0, 0.0]),
            )
        ],
    }
    (root / "v2.0").mkdir(parents=True)
    for name, records in tables.items():
        (root / "v2.0" / f"{name}.json").write_text(json.dumps(records))
    (root / "sweeps/LIDAR_TOP_id_1").mkdir(parents=True)
    np.pad(np.array(points, dtype=np.float32), ((0, 0), (0, 2))).tofile(root / "sweeps/LIDAR_TOP_id_1/a.pcd.bin")
    return root
