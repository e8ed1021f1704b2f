"""nuScenes: tables, keyframes at 2 Hz, and one LiDAR.

    open_source("nuscenes:/data/nuscenes?version=v1.0-mini&split=mini_val&sweeps=10")

Source: Caesar et al., "nuScenes", CVPR 2020, its schema and its devkit, read for their conventions.

Convention:
    world    the tables' global frame: right-handed, x and y level, z up; m. Ego poses have z = 0 there.
    ego      the middle of the rear axle, on the road; x ahead, y to the left.
    sensor   LIDAR_TOP's own frame, x to the right of the vehicle, y ahead: `calibrated_sensor` turns it.
Reading is that of V2X-Sim (`cp_env.scenes.v2xsim.tabled`), which keeps the same tables. What differs: one channel,
LIDAR_TOP; sweeps between keyframes; an ego that is not annotated, and gets the box of a Renault Zoe over its ego pose;
the names of categories; the splits.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from cp_env.geometry import spatial
from cp_env.lidar.returns import MARGIN
from cp_env.scenes.nuscenes.splits import choose
from cp_env.scenes.v2xsim.build import Bare
from cp_env.scenes.v2xsim.index import NUSCENES, Rows
from cp_env.scenes.v2xsim.indexing import open_index
from cp_env.scenes.v2xsim.tabled import Tabled, read_points
from cp_env.scenes.v2xsim.tables import find_tables

CATEGORIES = (
    "vehicle.car",
    "vehicle.emergency",
    "vehicle.truck",
    "vehicle.bus",
    "vehicle.trailer",
    "vehicle.construction",
)
ZOE = Bare((4.084, 1.73, 1.562), 1.4)
"""The ego: a Renault Zoe, as its maker gives its size; its middle is 1.4 m ahead of the rear axle (our estimate)."""

MOST = 50  # sweeps of a frame: 2.5 s
_EGO = 1  # the agent whose LiDAR it is


class NuScenes(Tabled):
    """Scenes of a nuScenes folder (a `SceneSource`): keyframes, seen by one vehicle.

    For training and calibrating detectors, and for similarities of frames without an attack. An environment plays two
    connected vehicles or more, and refuses these scenes.

    Args:
        path: the folder that holds `samples`, `sweeps` and the folder of tables.
        version: the folder of tables, such as "v1.0-mini"; need not be said if there is one only.
        split: "train", "val", "mini_train", "mini_val" (the official ones) or "all".
        scenes: only these, by name or number: "scene-0061" or "61".
        vehicles: connected vehicles that are asked for: 1.
        categories: what counts as a vehicle, by the beginning of its category's name; "vehicle" adds two-wheelers.
        sweeps: of how many sweeps a frame is made: its own and those before it, moved by the ego's motion alone. Public
            detectors often take 10, half a second.
        skip_broken: leave broken scenes out, and list them in `left_out`, instead of raising.
        progress: show a bar while the tables are indexed.

    Raises:
        BrokenData: a missing, cut short or contradictory file, with its name and the reason.
        ValueError: no such split or scene, more than one vehicle, or a number of sweeps out of range.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        version: str | None = None,
        split: str = "all",
        scenes: tuple[str, ...] = (),
        vehicles: int = 1,
        categories: tuple[str, ...] = CATEGORIES,
        sweeps: int = 1,
        skip_broken: bool = False,
        progress: bool = True,
    ) -> None:
        if vehicles != 1:
            raise ValueError(
                f"nuScenes was recorded by one vehicle: vehicles must be 1, not {vehicles}; sources with more are "
                "v2x-sim, opv2v, v2v4real, v2x-real and dair-v2x"
            )
        if not 1 <= sweeps <= MOST:
            raise ValueError(f"sweeps must be from 1 to {MOST}, not {sweeps}")
        root = Path(path)
        index = open_index(find_tables(root, version), NUSCENES, progress=progress)
        names = [entry.name for entry in index.entries]
        place = {names[k]: k for k in choose(names, split, scenes)}
        self._sweeps = sweeps
        super().__init__(
            f"nuscenes/{split}",
            root,
            index,
            place,
            vehicles=vehicles,
            categories=categories,
            rsu=False,
            bare=ZOE,
            skip_broken=skip_broken,
        )

    def _options(self) -> tuple[object, ...]:
        return ("nuscenes", self._sweeps)

    def _files(self, rows: Rows) -> list[str]:
        return super()._files(rows) + (rows.between_sweep.tolist() if self._sweeps > 1 else [])

    def _read(self, rows: Rows, frame: int, agent: int) -> Float[np.ndarray, "P 3"]:
        """The points of a keyframe's sweep, and of those before it, in the keyframe's sensor frame; m."""
        clouds = [super()._read(rows, frame, agent)]
        if self._sweeps == 1:
            return clouds[0]
        sensor_T_world = spatial.inverse(rows.world_T_sensor[frame, agent])
        for file, world_T_sensor, world_T_ego in self._before(rows, frame):
            points = read_points(self._root / file)
            points = points[_not_own(points, spatial.chain(spatial.inverse(world_T_ego), world_T_sensor))]
            moved = spatial.chain(sensor_T_world, world_T_sensor).astype(np.float32)
            clouds.append(points @ moved[:, :3].T + moved[:, 3])
        return np.concatenate(clouds)

    def _before(self, rows: Rows, frame: int) -> list[tuple[str, Float[np.ndarray, "3 4"], Float[np.ndarray, "3 4"]]]:
        """File, world_T_sensor and world_T_ego of the sweeps before a keyframe's, the latest last."""
        time = np.concatenate([rows.time[:frame], rows.between_time])
        files = np.concatenate([rows.sweep[:frame, _EGO], rows.between_sweep])
        sensor = np.concatenate([rows.world_T_sensor[:frame, _EGO], rows.between_sensor])
        ego = np.concatenate([rows.world_T_ego[:frame, _EGO], rows.between_ego])
        order = np.argsort(time, kind="stable")
        earlier = order[time[order] < rows.time[frame]][-(self._sweeps - 1) :]
        return [(str(files[k]), sensor[k], ego[k]) for k in earlier]


def _not_own(points: Float[np.ndarray, "P 3"], ego_T_sensor: Float[np.ndarray, "3 4"]) -> Bool[np.ndarray, " P"]:
    """Which points are not over or under the ego itself, where it was when they were taken."""
    length, width, _ = ZOE.size
    x, y = (points @ ego_T_sensor[:2, :3].T.astype(points.dtype) + ego_T_sensor[:2, 3].astype(points.dtype)).T
    ahead = ZOE.ahead or 0.0
    return np.asarray((np.abs(x - ahead) > length / 2 + MARGIN) | (np.abs(y) > width / 2 + MARGIN))
