"""Scenes from OPV2V's folders, whatever family of data is in them."""

from __future__ import annotations

import hashlib
import sys
from collections import OrderedDict
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
from jaxtyping import Float

from cp_env.progress import say, track
from cp_env.scenes.assembly.road import DRAWN, EXACT, Road
from cp_env.scenes.assembly.sweep import placed_sweep
from cp_env.scenes.errors import BrokenData, LeftOut, sift
from cp_env.scenes.opv2v import frame_rate
from cp_env.scenes.opv2v.axes import mirrored
from cp_env.scenes.opv2v.build import FrameSequence, Notes, build, localised
from cp_env.scenes.opv2v.classes import Choice
from cp_env.scenes.opv2v.files import Note, read_note, read_points
from cp_env.scenes.opv2v.folders import Scenario, runs, scenarios, survey
from cp_env.scenes.opv2v.layouts import Layout
from cp_env.types import Scene, Sweep

VERSION = 3
"""Part of the digest: rises when the same files give other sweeps."""

RATE = 5.0
"""Frames a second by default: that of the town and of V2X-Sim."""

POSES = ("true", "predicted")
ANGLES = ("auto", "degrees", "radians")
_KEPT = 16  # scenes whose poses stay in memory; a hundred frames of five agents take about 1 MB
_WITNESSES = 10  # files of each agent that tell the frame rate where numbers leave it open


@dataclass(frozen=True)
class Options:
    """What a user may choose; `OPV2V`, `V2V4Real` and `V2XReal` explain each."""

    scenes: tuple[str, ...] = ()
    vehicles: int = 1
    stride: int | None = None
    tick: float | None = None
    rsu: bool = True
    poses: str = "true"
    noise: tuple[float, ...] = (0.0, 0.0)
    seed: int = 0
    classes: tuple[str, ...] = ("vehicle",)
    angles: str = "degrees"
    skip_broken: bool = False

    def __post_init__(self) -> None:
        if self.poses not in POSES:
            raise ValueError(f"poses must be one of {', '.join(POSES)}; got {self.poses!r}")
        if self.angles not in ANGLES:
            raise ValueError(f"angles must be one of {', '.join(ANGLES)}; got {self.angles!r}")
        if len(self.noise) != 2 or not min(self.noise) >= 0 or not np.isfinite(self.noise).all():
            raise ValueError(f"noise must be two deviations, m and degrees, such as 0.2,0.2; got {self.noise}")
        if (self.stride is not None and self.stride < 1) or (self.tick is not None and not 0 < self.tick < np.inf):
            raise ValueError(f"stride must be at least 1 and tick above 0 seconds: got {self.stride} and {self.tick}")


@dataclass
class _Checked:
    """What has been read and found good while everything is read first."""

    notes: dict[tuple[Path, bool], Note] = field(default_factory=dict)
    points: set[Path] = field(default_factory=set)


@dataclass(frozen=True)
class Piece:
    """The frames of one scene: those of a scenario between two holes."""

    scenario: Scenario
    numbers: tuple[str, ...]
    tick: float  # s that one file number stands for
    stride: int  # files from frame to frame

    @property
    def dt(self) -> float:
        return self.scenario.step * self.stride * self.tick


class Recorded:
    """One split of a data set in OPV2V's folders (a `SceneSource`); its families derive from it.

    Args:
        path: the data set's folder, or the folder of one split.
        split: name of the folder inside it.
        layout: how to understand its files.
        options: what the user chose.

    Raises:
        BrokenData: the folder or a file is missing, or, when they are read, broken: the file and the reason are named.
        ValueError: an option out of range, unknown scenes, or no scenario with enough vehicles.
    """

    def __init__(self, path: str | Path, split: str, layout: Layout, options: Options) -> None:
        self.root = Path(path) / split
        self.name = f"{layout.kind}/{split or self.root.name}"
        self.layout, self.options = layout, options
        self.choice = Choice.of(options.classes)
        self._sequences: OrderedDict[str, FrameSequence] = OrderedDict()
        self._checked = _Checked() if options.skip_broken else None
        self._pieces: dict[str, Piece] = {}
        vehicles: dict[str, int] = {}  # of each scenario
        lost: list[LeftOut] = []

        def check(name: str) -> None:
            scenario = survey(folders[name])
            vehicles[name] = len(scenario.vehicles)
            if vehicles[name] < max(options.vehicles, 1):
                return
            pieces, faults = self._open(scenario if options.rsu else scenario.without_unit())
            every = not options.scenes or name in options.scenes
            self._pieces.update({piece: it for piece, it in pieces.items() if every or piece in options.scenes})
            lost.extend(LeftOut(f"{name}, frame {number}", e.file, e.reason) for number, e in faults.items())

        folders = scenarios(self.root)
        asked = {scene: scene if scene in folders else scene.rpartition("@")[0] for scene in options.scenes}
        if unknown := sorted(scene for scene, folder in asked.items() if folder not in folders):
            raise ValueError(f"unknown scenes {', '.join(unknown)} in {self.root}; known: {', '.join(folders)}")
        _, left_out = sift(dict.fromkeys(asked.values()) or folders, check, skip_broken=options.skip_broken)
        self._checked = None
        for item in lost:
            say(str(item), sys.stdout)
        self.left_out = (*left_out, *lost)
        self._names = tuple(self._pieces)
        if not self._names:
            most = max(vehicles.values())
            if most >= max(options.vehicles, 1):
                raise ValueError(f"none of the scenes {', '.join(options.scenes)} is in {self.root}")
            raise ValueError(f"no scenario of {self.root} has {options.vehicles} vehicles; the most are {most}")
        self.digest = self._digest()

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_sequences": OrderedDict()}

    def names(self) -> tuple[str, ...]:
        """The scenes, in a fixed order: scenarios, or pieces of them, named `<scenario>@<first file's number>`."""
        return self._names

    def load(self, name: str) -> Scene:
        """One scene.

        Raises:
            BrokenData: a file is broken, or files contradict each other on their frame rate.
            ValueError: unknown name.
        """
        return self._sequence(name).scene

    def sweeps(self, scene: Scene, frames: Sequence[int]) -> list[list[Sweep]]:
        """`[frame][agent]`: the connected vehicles in order, then the road-side unit if there is one.

        A sweep's `origin` is the middle of the box of the vehicle that carries the sensor, at the sensor's height:
        grid frames begin at vehicles, and OPV2V's sensors stand half a metre behind the middle of theirs.
        """
        sequence = self._sequence(scene.name)
        return [[self._sweep(sequence, int(t), agent) for agent in range(len(sequence.files[0]))] for t in frames]

    def _kinds(self, scene: Scene) -> tuple[str, ...]:
        """The `obj_type` of each of the scene's vehicles, "vehicle" where the files give none."""
        return self._sequence(scene.name).kinds

    # ── opening ──────────────────────────────────────────────────────────────────────────────────────────────────────

    def _open(self, scenario: Scenario) -> tuple[dict[str, Piece], dict[str, BrokenData]]:
        """The pieces of one scenario by name, and the faults that cost a frame, by the number of its files."""
        faults = dict(scenario.missing)
        if faults and self._checked is None:
            raise next(iter(faults.values()))
        while True:
            try:
                pieces = self._cut(scenario, faults)
                found = {k: v for name, piece in pieces.items() for k, v in self._read_through(name, piece).items()}
                if not found:
                    used = {number for run in runs(scenario, next(iter(pieces.values())).stride) for number in run}
                    return pieces, {number: error for number, error in faults.items() if number in used}
                faults.update(found)
            except BrokenData as error:  # of files that contradict each other
                number, inside = error.file.stem, error.file.parent.parent == scenario.folder
                if self._checked is None or not inside or number not in scenario.numbers or number in faults:
                    raise
                faults[number] = error

    def _cut(self, scenario: Scenario, faults: Collection[str]) -> dict[str, Piece]:
        """The pieces of one scenario by name, if files of these numbers cannot be used."""
        tick = self._tick(scenario, faults)
        stride = self.options.stride or max(1, round(1 / (RATE * scenario.step * tick)))
        found = runs(scenario, stride, faults)
        if not found:
            raise BrokenData(
                scenario.folder, f"has no frame whose files are all there and whole: {len(faults)} are not"
            )
        name = scenario.folder.name
        return {
            name if len(found) == 1 else f"{name}@{numbers[0]}": Piece(scenario, numbers, tick, stride)
            for numbers in found
        }

    def _tick(self, scenario: Scenario, faults: Collection[str]) -> float:
        """Seconds that one file number stands for: as the user says, by the numbers, or by what some files say."""
        if self.options.tick is not None:
            return self.options.tick
        times = frame_rate.by_numbers(scenario, self.layout)
        if len(times) == 1:
            return times[0]
        sound = [number for number in scenario.numbers if number not in faults][:_WITNESSES]
        frames = [(number, self._row(scenario, number, radians=False)) for number in sound]
        return frame_rate.settle(scenario, self.layout, frames)

    def _read_through(self, name: str, piece: Piece) -> dict[str, BrokenData]:
        """The faults of a piece by number, if everything is to be read first."""
        faults: dict[str, BrokenData] = {}
        if self._checked is None:
            return faults
        radians = self._in_radians(piece)
        for number in track(piece.numbers, f"checking {name}", unit="frame"):
            try:
                self._row(piece.scenario, number, radians=radians)
                for file in [piece.scenario.points(agent, number) for agent in piece.scenario.agents]:
                    if file not in self._checked.points:
                        read_points(file)
                        self._checked.points.add(file)
            except BrokenData as error:
                faults[number] = error
        if not faults:
            self._build(name, piece)
        return faults

    def _digest(self) -> str:
        """Changes with every option that sweeps depend on, and with name, size or time of any file that is read."""
        o = self.options
        options = (o.stride, o.tick, o.poses, o.noise, o.seed, o.classes, o.angles, o.rsu)
        sha = hashlib.sha256(repr((VERSION, self.name, options, self._names)).encode())
        for name, piece in self._pieces.items():
            for agent in piece.scenario.agents:
                for number in piece.numbers:
                    for file in (piece.scenario.note(agent, number), piece.scenario.points(agent, number)):
                        status = file.stat()
                        sha.update(f"{name}/{agent}/{file.name} {status.st_size} {status.st_mtime_ns}".encode())
        return sha.hexdigest()

    # ── reading ──────────────────────────────────────────────────────────────────────────────────────────────────────

    def _sequence(self, name: str) -> FrameSequence:
        if name not in self._pieces:
            raise ValueError(f"unknown scene {name!r}; {self.name} holds {', '.join(self._names)}")
        if name not in self._sequences:
            self._sequences[name] = self._build(name, self._pieces[name])
        self._sequences.move_to_end(name)
        while len(self._sequences) > _KEPT:
            self._sequences.popitem(last=False)
        return self._sequences[name]

    def _build(self, name: str, piece: Piece) -> FrameSequence:
        scenario, numbers = piece.scenario, piece.numbers
        radians = self._in_radians(piece)
        notes = [self._row(scenario, number, radians=radians) for number in numbers]
        if self.options.tick is None:
            frame_rate.check(scenario, piece.tick, list(zip(numbers, notes, strict=True)))
        sequence = build(scenario, numbers, notes, self.layout, self.choice, piece.dt, name)
        believed = sequence.place + self._error(scenario, numbers, notes, sequence.place)
        return replace(sequence, believed=believed)

    def _row(self, scenario: Scenario, number: str, *, radians: bool) -> list[Note]:
        """What each agent says of one frame."""
        return [self._note(scenario.note(agent, number), radians) for agent in scenario.agents]

    def _note(self, file: Path, radians: bool) -> Note:
        if self._checked is None:
            return read_note(file, self.layout, radians=radians)
        if (file, radians) not in self._checked.notes:
            self._checked.notes[file, radians] = read_note(file, self.layout, radians=radians)
        return self._checked.notes[file, radians]

    def _in_radians(self, piece: Piece) -> bool:
        """Whether angles are: if none of some frames exceeds half a turn in rad."""
        if self.options.angles != "auto":
            return self.options.angles == "radians"
        some = piece.numbers[:: max(1, len(piece.numbers) // _WITNESSES)]
        rows = [self._row(piece.scenario, number, radians=False) for number in some]
        return all(note.widest <= np.pi + 0.01 for row in rows for note in row)

    def _error(
        self, scenario: Scenario, numbers: Sequence[str], notes: Notes, place: Float[np.ndarray, "T A 3"]
    ) -> Float[np.ndarray, "T A 3"]:
        """How far the ego takes each agent from where it is; m, m, rad. Nothing for the ego itself."""
        error = np.zeros_like(place)
        if self.options.poses == "predicted":
            error += localised(scenario, numbers, notes, place) - place
            error[..., 2] = (error[..., 2] + np.pi) % (2 * np.pi) - np.pi
        across, turn = self.options.noise
        deviation = np.array([across, across, np.deg2rad(turn)])
        for t, number in enumerate(numbers):
            rng = np.random.default_rng([self.options.seed, crc32(scenario.folder.name.encode()), int(number)])
            error[t] += deviation * rng.standard_normal(place[t].shape)
        error[:, 0] = 0
        return error

    def _sweep(self, sequence: FrameSequence, t: int, agent: int) -> Sweep:
        world_T_lidar, place, scene = sequence.world_T_lidar[t, agent], sequence.place[t, agent], sequence.scene
        softness = EXACT if self.layout.on_ground else DRAWN
        road = Road.through(sequence.feet[t], place[:2], float(sequence.ground[t, agent]), softness)
        own = int(scene.connected[agent]) if agent < scene.n_connected else None
        turn = world_T_lidar[:, :3] if self.layout.right_handed else mirrored(world_T_lidar[:, :3])
        world_T_file = np.column_stack([turn, world_T_lidar[:, 3]])  # takes points as the file stores them
        points = read_points(sequence.files[t][agent])
        sweep = placed_sweep(points, world_T_file, road, sequence.boxes[t], sequence.tilt[t], own)
        error = sequence.believed[t, agent] - place
        if not error.any():
            return sweep
        points = sweep.points.copy()
        astray = np.array([[np.cos(error[2]), np.sin(error[2])], [-np.sin(error[2]), np.cos(error[2])]])
        points[:, :2] = points[:, :2] @ astray.astype(np.float32) + error[:2].astype(np.float32)
        return replace(sweep, points=points)
