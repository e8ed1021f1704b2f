"""V2X-Sim 2.0 as it is distributed: tables in the nuScenes format and one file a LiDAR sweep.

Source: Li et al., "V2X-Sim", RA-L 2022; the format is that of nuScenes (Caesar et al., CVPR 2020).

Convention:
    world    the tables' global frame: right-handed, x and y level, z up; m. We call its x axis east.
    sensor   a LiDAR's own frame, in which its file stores points; `world_T_sensor = world_T_ego · ego_T_sensor`.
    box      centre, (width, length, height), quaternion in the tables; the heading is the turned x axis, seen from
             above. A vehicle may pitch and roll: its returns are counted, and its own left out, along its box's axes.
    ground   under a sensor: the foot of its carrier's box; under a road-side unit: the median foot of boxes near it.
    Points go through the whole chain in three dimensions, and x and y are taken at its end: no map is tilted, and none
    has to be warped for it. On a hill z is height above the ground under the sensor, not under the point.
    A sweep is given from the middle of its carrier's box, at the sensor's height: that is the place a vehicle shares.
    Returns from the carrier itself are left out.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float

from cp_env.lidar.returns import count_returns as count_upright
from cp_env.lidar.returns import to_world_axes
from cp_env.scenes.errors import BrokenData, sift
from cp_env.scenes.v2xsim.build import RSU, FrameSequence, build, present
from cp_env.scenes.v2xsim.index import open_index
from cp_env.scenes.v2xsim.splits import choose
from cp_env.scenes.v2xsim.tables import find_tables
from cp_env.scenes.v2xsim.tilt import count_returns as count_leaning
from cp_env.scenes.v2xsim.tilt import leaning, over_or_under
from cp_env.types import Scene, Sweep

CATEGORIES = ("vehicle.car", "vehicle.emergency", "vehicle.van", "vehicle.truck", "vehicle.bus", "vehicle.trailer")
_POINT = np.dtype((np.float32, 5))  # x, y, z, intensity, ring or object


class V2XSim:
    """Scenes of a V2X-Sim 2.0 folder (a `SceneSource`); connected are the vehicles with a sweep in every frame.

    Args:
        path: the folder that holds `sweeps` and the folder of tables.
        split: "train", "val", "test" (the official ones) or "all".
        scenes: only these, by name or number.
        vehicles: leave out scenes with fewer connected vehicles.
        categories: what counts as a vehicle, by the beginning of its category's name. coperception's ground truth is
            "vehicle.car,vehicle.emergency.police". Vehicles that carry a sensor always count.
        rsu: whether scenes show their road-side unit.
        version: the folder of tables, if there are several.
        skip_broken: leave broken scenes out, and list them in `left_out`, instead of raising.
        progress: show a bar while the tables are indexed.

    Raises:
        BrokenData: a missing, cut short or contradictory file, with its name and the reason.
        ValueError: no such split or scene, or none left.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        split: str = "all",
        scenes: tuple[str, ...] = (),
        vehicles: int = 1,
        categories: tuple[str, ...] = CATEGORIES,
        rsu: bool = True,
        version: str | None = None,
        skip_broken: bool = False,
        progress: bool = True,
    ) -> None:
        self.name = f"v2x-sim/{split}"
        self._root = Path(path)
        self._index = open_index(find_tables(self._root, version), progress=progress)
        self._categories, self._rsu = categories, rsu
        entries = self._index.entries
        self._place = {entries[k].name: k for k in choose([entry.name for entry in entries], split, scenes)}
        listing = _Listing(self._root)
        kept, self.left_out = sift(self._place, partial(self._check, listing), skip_broken=skip_broken)
        self._names = tuple(name for name in kept if self._n_vehicles(name) >= vehicles)
        if not self._names:
            raise ValueError(
                f"no scene of {self.name} in {self._root} has {vehicles} connected vehicles; ask for fewer"
            )
        self.digest = self._digest(listing)

    def names(self) -> tuple[str, ...]:
        """The scenes chosen, in the set's order."""
        return self._names

    def load(self, name: str) -> Scene:
        """One scene; the same object each time it is asked for, until some others were.

        Raises:
            ValueError: unknown name.
        """
        if name not in self._names:
            raise ValueError(f"unknown scene {name!r}; {self.name} holds {', '.join(self._names)}")
        return self._sequence(name).scene

    def sweeps(self, scene: Scene, frames: Sequence[int]) -> list[list[Sweep]]:
        """`[frame][agent]`: the connected vehicles in order, then the road-side unit if the scene shows one.

        Raises:
            BrokenData: a sweep's file is missing, cut short, empty, or holds what is no number.
        """
        sequence = self._sequence(scene.name)
        return [[self._sweep(sequence, int(frame), agent) for agent in sequence.agents] for frame in frames]

    def classes(self, scene: Scene) -> tuple[str, ...]:
        """The category's name of each of the scene's vehicles; "not annotated" of a carrier that has no box."""
        return self._sequence(scene.name).classes

    def _sequence(self, name: str) -> FrameSequence:
        return build(self._index, self._place[name], self._categories, self._rsu)

    def _n_vehicles(self, name: str) -> int:
        return len(present(self._index.rows(self._place[name])))

    def _check(self, listing: _Listing, name: str) -> None:
        """BrokenData unless the records of a scene agree and its files are there and whole."""
        entry = self._index.entries[self._place[name]]
        if entry.fault:
            raise BrokenData(*entry.fault)
        rows = self._index.rows(self._place[name])
        if not len(present(rows)):
            raise BrokenData(
                self._root, f"no vehicle of {name} has a sweep in every one of its {len(rows.time)} frames"
            )
        moved = np.ptp(rows.world_T_sensor[:, RSU, :, 3], axis=0)
        if np.nanmax(moved, initial=0) > 0.5:
            raise BrokenData(self._root, "LIDAR_TOP_id_0 moves, a road-side unit does not: is this V2X-Sim 1.0?")
        for file in rows.sweep[rows.sweep != ""].tolist():
            _check_size(self._root / file, listing.size(file))

    def _digest(self, listing: _Listing) -> str:
        sha = hashlib.sha256(repr(("v2x-sim-2", self._index.digest, self._categories, self._rsu)).encode())
        for name in self._names:
            for file in self._index.rows(self._place[name]).sweep.ravel().tolist():
                sha.update(repr((file, listing.stamp(file))).encode())
        return sha.hexdigest()

    def _sweep(self, sequence: FrameSequence, frame: int, agent: int) -> Sweep:
        path = self._root / str(sequence.rows.sweep[frame, agent])
        world_T_sensor = sequence.rows.world_T_sensor[frame, agent]
        origin, ground = sequence.origin[agent][frame], sequence.ground[frame, agent]
        shift = world_T_sensor[:, 3] - (origin[0], origin[1], ground)
        boxes = sequence.boxes[frame] - (origin[0], origin[1], ground, 0, 0, 0, 0)
        tilt = sequence.tilt[frame]
        own = None if agent == RSU else sequence.row[agent]
        points, hits = to_world_axes(read_points(path), world_T_sensor[:, :3], shift, boxes, own)
        rows = leaning(tilt)
        if own is not None and own in rows:
            keep = ~over_or_under(points, boxes[own], tilt[own])
            if not keep.all():
                points = points[keep]
                hits = count_upright(points, boxes)
        hits[rows] = count_leaning(points, boxes[rows], tilt[rows])
        return Sweep(points, origin, hits)


def read_points(path: Path) -> Float[np.ndarray, "P 3"]:
    """The points of a sweep's file in the sensor's frame; m.

    Raises:
        BrokenData: it cannot be read, is cut short or empty, or holds what is no number.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise BrokenData(path, error.strerror or str(error)) from error
    _check_size(path, len(data))
    points = np.ascontiguousarray(np.frombuffer(data, dtype=_POINT)[:, :3])
    if not np.isfinite(points).all():
        raise BrokenData(path, "it holds coordinates that are no finite numbers")
    return points


def _check_size(path: Path, size: int | None) -> None:
    if size is None:
        raise BrokenData(path, "missing sweep")
    if size == 0:
        raise BrokenData(path, "an empty sweep")
    if size % _POINT.itemsize:
        raise BrokenData(path, f"it is cut short: {size} bytes are no whole number of points of {_POINT.itemsize}")


class _Listing:
    """Sizes and times of a set's files; every folder is listed once."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._folders: dict[str, dict[str, os.stat_result]] = {}

    def size(self, file: str) -> int | None:
        found = self._stat(file)
        return None if found is None else found.st_size

    def stamp(self, file: str) -> tuple[int, int] | None:
        """Size and seconds of the last change: archives keep both."""
        found = self._stat(file)
        return None if found is None else (found.st_size, found.st_mtime_ns)

    def _stat(self, file: str) -> os.stat_result | None:
        folder, _, name = file.rpartition("/")
        if folder not in self._folders:
            try:
                with os.scandir(self._root / folder) as entries:
                    self._folders[folder] = {entry.name: entry.stat() for entry in entries if entry.is_file()}
            except OSError:
                self._folders[folder] = {}
        return self._folders[folder].get(name)
