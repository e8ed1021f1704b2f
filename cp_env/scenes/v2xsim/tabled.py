"""Scenes of tables in the nuScenes format, whichever data set they are of."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float

from cp_env.scenes.assembly.road import Road
from cp_env.scenes.assembly.sweep import placed_sweep
from cp_env.scenes.errors import BrokenData, sift
from cp_env.scenes.formats.bounded import read_bytes
from cp_env.scenes.formats.pcd import FILE_BYTES
from cp_env.scenes.v2xsim.build import RSU, UNDER, Bare, FrameSequence, build, present
from cp_env.scenes.v2xsim.index import Index, Rows
from cp_env.types import Scene, Sweep

VERSION = 3
"""Part of the digest: rises when the same files give other sweeps."""

_POINT = np.dtype((np.float32, 5))  # x, y, z, intensity, ring or object


class Tabled:
    """The scenes of an index (a `SceneSource`); its families derive from it.

    Args:
        name: of the source.
        root: the folder that the tables' file names begin at.
        index: of the tables.
        place: numbers in the index of the scenes to look at, by name.
        vehicles: leave out scenes with fewer connected vehicles.
        categories: what counts as a vehicle, by the beginning of its category's name.
        rsu: whether scenes show their road-side unit.
        bare: the box of a carrier that is not annotated.
        skip_broken: leave broken scenes out, and list them in `left_out`, instead of raising.

    Raises:
        BrokenData: a missing, cut short or contradictory file, with its name and the reason.
        ValueError: no scene is left.
    """

    def __init__(
        self,
        name: str,
        root: Path,
        index: Index,
        place: Mapping[str, int],
        *,
        vehicles: int,
        categories: tuple[str, ...],
        rsu: bool,
        bare: Bare = UNDER,
        skip_broken: bool = False,
    ) -> None:
        self.name, self._root, self._index, self._place = name, root, index, dict(place)
        self._categories, self._rsu, self._bare = categories, rsu, bare
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
        return build(self._index, self._place[name], self._categories, self._rsu, self._bare)

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
        for file in self._files(rows):
            _check_size(self._root / file, listing.size(file))

    def _digest(self, listing: _Listing) -> str:
        options = (VERSION, self._index.digest, self._categories, self._rsu, self._bare, *self._options())
        sha = hashlib.sha256(repr(options).encode())
        for name in self._names:
            rows = self._index.rows(self._place[name])
            for file in self._files(rows):
                sha.update(repr((file, listing.stamp(file))).encode())
        return sha.hexdigest()

    def _options(self) -> tuple[object, ...]:
        """What else sweeps depend on."""
        return ()

    def _files(self, rows: Rows) -> list[str]:
        """The sweeps of a scene that are read."""
        files: list[str] = rows.sweep[rows.sweep != ""].tolist()
        return files

    def _sweep(self, sequence: FrameSequence, frame: int, agent: int) -> Sweep:
        """One agent's sweep, from the middle of its carrier's box."""
        points = self._read(sequence.rows, frame, agent)
        place, level = sequence.origin[agent][frame, :2], float(sequence.ground[frame, agent])
        road = Road.through(sequence.feet[frame], place, level)
        own = None if agent == RSU else sequence.row[agent]
        world_T_sensor = sequence.rows.world_T_sensor[frame, agent]
        return placed_sweep(points, world_T_sensor, road, sequence.boxes[frame], sequence.tilt[frame], own)

    def _read(self, rows: Rows, frame: int, agent: int) -> Float[np.ndarray, "P 3"]:
        """The points of one agent in its sensor's frame; m."""
        return read_points(self._root / str(rows.sweep[frame, agent]))


def read_points(path: Path) -> Float[np.ndarray, "P 3"]:
    """The points of a sweep's file in the sensor's frame; m.

    Raises:
        BrokenData: it cannot be read, is cut short or empty, or holds what is no number.
    """
    try:
        data = read_bytes(path, FILE_BYTES)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else None
        raise BrokenData(path, reason or str(error)) from error
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
