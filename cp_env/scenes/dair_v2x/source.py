"""DAIR-V2X-C, the cooperative part of DAIR-V2X: one real vehicle and one road-side unit, as scenes.

    open_source("dair-v2x:/data/DAIR-V2X-C?split=val")

Source: Yu et al., "DAIR-V2X", CVPR 2022, and the data set's own documentation.

Convention: right-handed; metres. `world_T_lidar` is world_T_novatel · novatel_T_lidar for the vehicle, and the
calibration of the virtual LiDAR, with the pair's offset added to x and y, for the unit. Labels are eight corners in the
world. The vehicle's LiDAR looks along its x axis.
"""

from __future__ import annotations

import hashlib
import sys
from collections import OrderedDict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cp_env.progress import say, track
from cp_env.scenes.assembly.road import DRAWN, Road
from cp_env.scenes.assembly.sweep import placed_sweep
from cp_env.scenes.dair_v2x.build import FrameSequence, build, pieces, usual_step
from cp_env.scenes.dair_v2x.files import (
    Pair,
    files_of,
    find_root,
    read_labels,
    read_pairs,
    unit_pose,
    vehicle_pose,
)
from cp_env.scenes.dair_v2x.splits import find_split_file, plain, read_split
from cp_env.scenes.errors import BrokenData, LeftOut
from cp_env.scenes.opv2v.classes import DEFAULT, Choice
from cp_env.scenes.opv2v.files import read_points
from cp_env.types import Scene, Sweep

VERSION = 1
"""Part of the digest: rises when the same files give other sweeps."""

RATE = 5.0
"""Frames a second by default: that of the town and of V2X-Sim."""

UNITS = ("sender", "rsu")
_KEPT = 16  # scenes whose poses stay in memory


class DairV2X:
    """One split of DAIR-V2X-C (a `SceneSource`).

    A scene is a stretch of a batch without holes, named by the batch, with the number of its first frame if the batch
    has several. The ego is the vehicle. Labels have no numbers: vehicles are followed by place, pace and size.

    Args:
        path: the folder `cooperative-vehicle-infrastructure`, or the one that holds it.
        split: "all", or a name in the file of the official splits: "train", "val", "test".
        split_file: that file, `cooperative-split-data.json` of the set's toolkit; looked for in the set's folder and
            the two above it.
        scenes: only these, by name.
        frames: leave out scenes with fewer.
        vehicles: leave out scenes with fewer connected vehicles: all have two with `unit=sender`, one with `unit=rsu`.
        stride: every so many frames are kept; by default what comes nearest to `RATE`.
        unit: "sender", the unit is the second connected vehicle: an environment plays two vehicles or more; or "rsu",
            the scene's road-side unit.
        offset: whether the unit's place is mended by the offset that the set gives; without it, its points lie where
            the calibration alone puts them.
        classes: what counts as a vehicle: groups and types of `cp_env.scenes.opv2v.classes.CLASSES`.
        skip_broken: read everything first, and leave the frames out that a broken file touches; `left_out` says which.

    Raises:
        BrokenData: the folder or a file is missing, or, when they are read, broken: the file and the reason are named.
        ValueError: an option out of range, an unknown split or scene, or no scene that is long enough.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        split: str = "all",
        split_file: str | None = None,
        scenes: tuple[str, ...] = (),
        frames: int = 2,
        vehicles: int = 1,
        stride: int | None = None,
        unit: str = "sender",
        offset: bool = True,
        classes: tuple[str, ...] = DEFAULT,
        skip_broken: bool = False,
    ) -> None:
        if unit not in UNITS:
            raise ValueError(f"unit must be one of {', '.join(UNITS)}; got {unit!r}")
        if (stride is not None and stride < 1) or frames < 1:
            raise ValueError(f"stride and frames must be at least 1: got {stride} and {frames}")
        if vehicles > (most := 1 + (unit == "sender")):
            raise ValueError(f"a scene of dair-v2x has {most} connected vehicles with unit={unit}, not {vehicles}")
        self.root = find_root(Path(path))
        self.name = f"dair-v2x/{split}"
        self.choice = Choice.of(classes)
        self._sender, self._offset, self._stride = unit == "sender", offset, stride
        self._sequences: OrderedDict[str, FrameSequence] = OrderedDict()
        pairs = read_pairs(self.root)
        if split != "all":
            kept = read_split(find_split_file(self.root, split_file), split)
            pairs = tuple(pair for pair in pairs if plain(pair.vehicle) in kept)
        faults = self._faults(pairs, everything=skip_broken)
        if faults and not skip_broken:
            raise next(iter(faults.values()))
        self._pairs = {name: run for name, run in self._runs(pairs, faults).items() if len(run) >= frames}
        if not self._pairs:
            raise ValueError(f"no scene of {self.name} in {self.root} has {frames} frames; ask for fewer")
        if unknown := [name for name in scenes if name not in self._pairs]:
            raise ValueError(f"unknown scene {unknown[0]!r}; {self.name} holds {', '.join(self._pairs)}")
        self._pairs = {name: self._pairs[name] for name in dict.fromkeys(scenes) or self._pairs}
        self.left_out = tuple(LeftOut(f"frame {number}", e.file, e.reason) for number, e in faults.items())
        for item in self.left_out:
            say(str(item), sys.stdout)
        self.digest = self._digest((unit, offset, classes))

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_sequences": OrderedDict()}

    def names(self) -> tuple[str, ...]:
        """The scenes, in the order of their first frames."""
        return tuple(self._pairs)

    def load(self, name: str) -> Scene:
        """One scene.

        Raises:
            BrokenData: a file is broken.
            ValueError: unknown name.
        """
        return self._sequence(name).scene

    def sweeps(self, scene: Scene, frames: Sequence[int]) -> list[list[Sweep]]:
        """`[frame][agent]`: the vehicle, then the unit.

        Raises:
            BrokenData: a file is broken.
        """
        sequence = self._sequence(scene.name)
        return [[self._sweep(sequence, int(t), agent) for agent in range(2)] for t in frames]

    def classes(self, scene: Scene) -> tuple[str, ...]:
        """The label's type of each of the scene's vehicles; "vehicle" of the ego that is not labelled, "unit"."""
        return self._sequence(scene.name).kinds

    def _runs(self, pairs: Sequence[Pair], faults: dict[str, BrokenData]) -> dict[str, tuple[Pair, ...]]:
        """The frames of each scene by its name."""
        batches: dict[str, list[Pair]] = {}
        for pair in sorted(pairs, key=lambda pair: pair.time):
            batches.setdefault(pair.batch, []).append(pair)
        found: dict[str, tuple[Pair, ...]] = {}
        for batch, there in batches.items():
            times = [pair.time for pair in there]
            stride = self._stride or max(1, round(1e6 / (RATE * usual_step(times))))
            lost = {k for k, pair in enumerate(there) if pair.vehicle in faults}
            runs = pieces(times, stride, lost)
            for run in runs:
                name = f"batch-{batch}" + (f"@{there[run[0]].vehicle}" if len(runs) > 1 else "")
                found[name] = tuple(there[k] for k in run)
        return found

    def _faults(self, pairs: Sequence[Pair], *, everything: bool) -> dict[str, BrokenData]:
        """What is wrong, by the vehicle's frame: missing files, or whatever reading all of them shows."""
        faults: dict[str, BrokenData] = {}
        for pair in track(pairs, f"checking {self.name}", unit="frame") if everything else pairs:
            try:
                for file in files_of(self.root, pair):
                    if not file.is_file():
                        raise BrokenData(file, "is missing")
                if everything:
                    self._read(pair)
                    for file in files_of(self.root, pair)[:2]:
                        read_points(file)
            except BrokenData as error:
                faults[pair.vehicle] = error
        return faults

    def _read(self, pair: Pair) -> tuple[Any, Any]:
        """The labels of a frame, and the poses of both LiDARs."""
        poses = [vehicle_pose(self.root, pair), unit_pose(self.root, pair, offset=self._offset)]
        return read_labels(self.root, pair), np.array(poses)

    def _digest(self, options: tuple[Any, ...]) -> str:
        """Changes with every option that sweeps depend on, and with name, size or time of any file that is read."""
        sha = hashlib.sha256(repr((VERSION, self.name, options, tuple(self._pairs.items()))).encode())
        for pairs in self._pairs.values():
            for pair in pairs:
                for file in files_of(self.root, pair):
                    status = file.stat()
                    sha.update(f"{status.st_size} {status.st_mtime_ns} ".encode())
        return sha.hexdigest()

    def _sequence(self, name: str) -> FrameSequence:
        if name not in self._pairs:
            raise ValueError(f"unknown scene {name!r}; {self.name} holds {', '.join(self._pairs)}")
        if name not in self._sequences:
            read = [self._read(pair) for pair in self._pairs[name]]
            labels, poses = [said for said, _ in read], np.array([pose for _, pose in read])
            self._sequences[name] = build(
                self.root, name, self._pairs[name], labels, poses, self.choice, sender=self._sender
            )
        self._sequences.move_to_end(name)
        while len(self._sequences) > _KEPT:
            self._sequences.popitem(last=False)
        return self._sequences[name]

    def _sweep(self, sequence: FrameSequence, t: int, agent: int) -> Sweep:
        place, level = sequence.place[t, agent], float(sequence.level[t, agent])
        road = Road.through(sequence.feet[t], place, level, DRAWN)
        own = int(sequence.scene.connected[agent]) if agent < sequence.scene.n_connected else None
        points = read_points(sequence.files[t][agent])
        return placed_sweep(points, sequence.world_T_sensor[t, agent], road, sequence.boxes[t], sequence.tilt[t], own)
