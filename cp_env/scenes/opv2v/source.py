"""OPV2V and V2XSet: recorded drives in CARLA, as scenes.

    open_source("opv2v:/data/OPV2V?split=test&vehicles=5")

Convention: the files are left-handed and in degrees, see `opv2v_axes`; what comes out is ours, see `cp_env.types`. The
road is taken to be flat and level round each sensor, at the height of the origin of the vehicle next to it.
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
from jaxtyping import Float, Float32
from tqdm import tqdm

from cp_env.geometry.planar import compose, invert
from cp_env.lidar.returns import standing, to_world_axes
from cp_env.scenes.errors import BrokenData, sift
from cp_env.scenes.formats import pcd
from cp_env.scenes.opv2v.axes import from_carla, mirrored, planar
from cp_env.scenes.opv2v.files import Listed, Note, Scenario, read_note, scenarios, survey
from cp_env.types import Scene, Sweep

VERSION = 1
"""Part of the digest: rises when the same files give other sweeps."""

RATE = 5.0
"""Frames a second by default: that of the town and of V2X-Sim."""

POSES = ("true", "predicted")
UNSEEN = Listed(np.zeros(3), np.zeros(3), np.array([0.0, 0.0, 0.75]), np.array([2.45, 1.06, 0.75]))
"""The box of a connected vehicle that no other ever met: a Lincoln MKZ, which all connected ones of OPV2V are."""

_KEPT = 16  # scenes whose poses stay in memory; a hundred frames of five agents take about 1 MB


@dataclass(frozen=True, eq=False)
class FrameSequence:
    """A scene, and what it takes to read its sweeps; agents are its connected vehicles, then its road-side unit."""

    scene: Scene
    files: tuple[tuple[Path, ...], ...]  # [frame][agent]
    world_T_lidar: Float[np.ndarray, "T A 3 4"]
    ground: Float[np.ndarray, "T A"]  # height of the road under each sensor; m
    believed: Float[np.ndarray, "T A 3"]  # where the ego takes the agent to be; m, m, rad
    place: Float[np.ndarray, "T A 3"]  # where it is: box centre of a vehicle, sensor of a unit


class OPV2V:
    """One split of OPV2V or V2XSet, or any data in their layout (a `SceneSource`).

    Agents keep OpenCOOD's order: names sorted as text, the first is the ego; a road-side unit (V2XSet) is the last. A
    scene's vehicles are its agents, then all others ever listed by any of them, by number. A box stands where its
    `center` puts it along the vehicle's own axes (OpenCOOD adds `center` along the world's; it is centimetres).
    Returns from the vehicle that carries the sensor are left out, as in the town.

    Args:
        path: the data set's folder, or the folder of one split.
        split: name of the folder inside it, such as "train", "validate", "test" or "test_culver_city".
        scenes: names of scenarios; all by default.
        vehicles: leave out scenarios with fewer.
        stride: every so many files are a frame; by default what comes nearest to `RATE`: 2, as files are 10 Hz.
        tick: seconds from one file number to the next; CARLA's step. OPV2V and V2XSet number every second one.
        rsu: whether scenes show their road-side unit.
        poses: "true", or "predicted": others stand where their and the ego's recorded localisation put them.
        noise: deviations of the place (m) and the heading (degrees) at which the ego takes others to be, drawn anew
            for each agent and frame. Positions in `Scene` stay true; the points of others' sweeps are displaced.
        seed: of the noise.
        skip_broken: read everything first, and leave broken scenarios out; `left_out` says which.

    Raises:
        BrokenData: the folder or a file is missing, or, when they are read, broken: the file and the reason are named.
        ValueError: an option out of range, unknown scenes, or no scenario with enough vehicles.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        split: str = "",
        scenes: tuple[str, ...] = (),
        vehicles: int = 1,
        stride: int | None = None,
        tick: float = 0.05,
        rsu: bool = True,
        poses: str = "true",
        noise: tuple[float, ...] = (0.0, 0.0),
        seed: int = 0,
        skip_broken: bool = False,
    ) -> None:
        if poses not in POSES:
            raise ValueError(f"poses must be one of {', '.join(POSES)}; got {poses!r}")
        if len(noise) != 2 or min(noise) < 0:
            raise ValueError(f"noise must be two deviations, m and degrees, such as 0.2,0.2; got {noise}")
        if (stride is not None and stride < 1) or tick <= 0:
            raise ValueError(f"stride must be at least 1 and tick above 0: got {stride} and {tick}")
        self.root = Path(path) / split
        self.name = f"opv2v/{split or self.root.name}"
        self.stride, self.tick, self.poses, self.noise, self.seed = stride, tick, poses, noise, seed
        self._sequences: OrderedDict[str, FrameSequence] = OrderedDict()
        folders = scenarios(self.root)
        if unknown := sorted(set(scenes) - set(folders)):
            raise ValueError(f"unknown scenes {', '.join(unknown)} in {self.root}; known: {', '.join(folders)}")
        self._scenarios: dict[str, Scenario] = {}

        def check(name: str) -> None:
            scenario = survey(folders[name])
            self._scenarios[name] = scenario if rsu else replace(scenario, rsu=None)
            if skip_broken:
                self._read_through(name)

        names, self.left_out = sift(scenes or folders, check, skip_broken=skip_broken)
        self._names = tuple(name for name in names if len(self._scenarios[name].vehicles) >= vehicles)
        if not self._names:
            most = max(len(self._scenarios[name].vehicles) for name in names)
            raise ValueError(f"no scenario of {self.root} has {vehicles} vehicles; the most are {most}")
        self.digest = self._digest()

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_sequences": OrderedDict()}

    def _digest(self) -> str:
        """Changes with every option that sweeps depend on, and with name, size or time of any file that is read."""
        options = (self.stride, self.tick, self.poses, self.noise, self.seed)
        sha = hashlib.sha256(repr((VERSION, self.name, options, self._names)).encode())
        for name in self._names:
            scenario = self._scenarios[name]
            for agent in scenario.agents:
                for number in scenario.numbers:
                    for suffix in (".yaml", ".pcd"):
                        status = scenario.file(agent, number, suffix).stat()
                        sha.update(f"{name}/{agent}/{number}{suffix} {status.st_size} {status.st_mtime_ns}".encode())
        return sha.hexdigest()

    def names(self) -> tuple[str, ...]:
        """The scenarios, in a fixed order."""
        return self._names

    def load(self, name: str) -> Scene:
        """One scenario.

        Raises:
            BrokenData: a file is broken.
            ValueError: unknown name.
        """
        return self._sequence(name).scene

    def sweeps(self, scene: Scene, frames: Sequence[int]) -> list[list[Sweep]]:
        """`[frame][agent]`: the connected vehicles in order, then the road-side unit if there is one.

        A sweep's `origin` is the middle of the box of the vehicle that carries the sensor, at the sensor's height:
        grid frames begin at vehicles, and OPV2V's sensors stand half a metre behind the middle of theirs.
        """
        sequence = self._sequence(scene.name)
        return [[_sweep(sequence, int(t), agent) for agent in range(len(sequence.files[0]))] for t in frames]

    def _read_through(self, name: str) -> None:
        sequence = self._sequence(name)
        for files in tqdm(sequence.files, f"checking {name}", leave=False, unit="frame"):
            for file in files:
                _points(file)

    def _sequence(self, name: str) -> FrameSequence:
        if name not in self._scenarios:
            raise ValueError(f"unknown scene {name!r}; {self.name} holds {', '.join(self._names)}")
        if name not in self._sequences:
            self._sequences[name] = self._build(self._scenarios[name])
        self._sequences.move_to_end(name)
        while len(self._sequences) > _KEPT:
            self._sequences.popitem(last=False)
        return self._sequences[name]

    def _build(self, scenario: Scenario) -> FrameSequence:
        step = scenario.ticks * self.tick
        stride = self.stride or max(1, round(1 / (RATE * step)))
        numbers = scenario.numbers[::stride]
        notes = [[read_note(scenario.file(agent, number, ".yaml")) for agent in scenario.agents] for number in numbers]
        scene, origins = _scene(scenario, numbers, notes, step * stride)
        world_T_lidar = np.array([[from_carla(note.lidar) for note in row] for row in notes])
        place = np.concatenate([scene.pose[:, scene.connected], _unit(scenario, numbers, world_T_lidar)], axis=1)
        gap = np.linalg.norm(origins[:, None, :, :2] - world_T_lidar[:, :, None, :2, 3], axis=-1)
        ground = np.take_along_axis(origins[..., 2], np.nanargmin(gap, axis=2), axis=1)
        if scenario.rsu is not None:
            ground[:, -1] = np.median(ground[:, -1])  # it stands still, whoever drives by
            mast = world_T_lidar[0, -1, :, 3] - [0.0, 0.0, ground[0, -1]]
            scene = replace(scene, rsu=mast)
        files = tuple(tuple(scenario.file(agent, number, ".pcd") for agent in scenario.agents) for number in numbers)
        believed = place + self._error(scenario, numbers, notes, place)
        return FrameSequence(scene, files, world_T_lidar, ground, believed, place)

    def _error(
        self, scenario: Scenario, numbers: Sequence[str], notes: list[list[Note]], place: Float[np.ndarray, "T A 3"]
    ) -> Float[np.ndarray, "T A 3"]:
        """How far the ego takes each agent from where it is; m, m, rad. Nothing for the ego itself."""
        error = np.zeros_like(place)
        if self.poses == "predicted":
            error += _localised(scenario, numbers, notes, place) - place
            error[..., 2] = (error[..., 2] + np.pi) % (2 * np.pi) - np.pi
        deviation = np.array([self.noise[0], self.noise[0], np.deg2rad(self.noise[1])])
        for t, number in enumerate(numbers):
            rng = np.random.default_rng([self.seed, crc32(scenario.folder.name.encode()), int(number)])
            error[t] += deviation * rng.standard_normal(place[t].shape)
        error[:, 0] = 0
        return error


def _scene(
    scenario: Scenario, numbers: Sequence[str], notes: list[list[Note]], dt: float
) -> tuple[Scene, Float[np.ndarray, "T M 3"]]:
    """The scene, its road-side unit left out, and the vehicles' origins, NaN where absent; m."""
    connected = [int(agent) for agent in scenario.vehicles]
    others = {number for row in notes for note in row for number in note.vehicles} - set(connected)
    rows = {number: row for row, number in enumerate([*connected, *sorted(others)])}
    pose, origins = (np.full((len(notes), len(rows), 3), np.nan) for _ in range(2))
    boxes: dict[int, Listed] = {}
    for row in notes:
        for note in row:
            for number, listed in note.vehicles.items():
                boxes.setdefault(number, listed)
    for t, row in enumerate(notes):
        seen = {number: listed for note in reversed(row) for number, listed in note.vehicles.items()}
        for agent, note in zip(scenario.vehicles, row, strict=False):
            if int(agent) not in seen:
                if note.body is None:
                    raise BrokenData(
                        scenario.file(agent, numbers[t], ".yaml"), "lacks true_ego_pos, no other agent lists it"
                    )
                box = boxes.get(int(agent), UNSEEN)
                seen[int(agent)] = Listed(note.body[:3], note.body[3:], box.center, box.extent)
        for number, listed in seen.items():
            world_T_body = from_carla(listed.pose)
            centre = world_T_body @ np.append(mirrored(listed.center), 1.0)
            pose[t, rows[number]] = *centre[:2], planar(world_T_body)[2]
            origins[t, rows[number]] = world_T_body[:, 3]
    size = np.array([2 * boxes.get(number, UNSEEN).extent for number in rows])
    scene = Scene(
        name=scenario.folder.name,
        kind="recorded",
        dt=dt,
        pose=pose,
        size=size,
        connected=np.arange(len(connected)),
        rsu=None,
        obstacles=np.zeros((0, 6)),
    )
    return scene, origins


def _unit(
    scenario: Scenario, numbers: Sequence[str], world_T_lidar: Float[np.ndarray, "T A 3 4"]
) -> Float[np.ndarray, "T _ 3"]:
    """Place and heading of the road-side unit's sensor, one column; none without it."""
    if scenario.rsu is None:
        return np.zeros((len(world_T_lidar), 0, 3))
    sensor = world_T_lidar[:, -1]
    stray = np.linalg.norm(sensor[:, :, 3] - sensor[0, :, 3], axis=1)
    if stray.max() > 0.01:
        file = scenario.file(scenario.rsu, numbers[int(stray.argmax())], ".yaml")
        raise BrokenData(file, f"the road-side unit's lidar_pose is {stray.max():.2f} m from its first one")
    return planar(sensor)[:, None]


def _localised(
    scenario: Scenario, numbers: Sequence[str], notes: list[list[Note]], place: Float[np.ndarray, "T A 3"]
) -> Float[np.ndarray, "T A 3"]:
    """Where the recorded localisation of the ego and of each agent together put the agent; m, m, rad."""
    taken = np.empty_like(place)
    for t, row in enumerate(notes):
        poses = []
        for agent, note in zip(scenario.agents, row, strict=True):
            if note.body is None or note.predicted is None:
                file = scenario.file(agent, numbers[t], ".yaml")
                raise BrokenData(file, "lacks true_ego_pos and predicted_ego_pos; use poses=true")
            poses.append([planar(from_carla(note.body)), planar(from_carla(note.predicted))])
        true, predicted = np.array(poses).swapaxes(0, 1)
        here = compose(invert(true), place[t])  # the box in the body's frame
        ego = compose(true[0], invert(predicted[0]))
        taken[t] = compose(np.broadcast_to(ego, predicted.shape), compose(predicted, here))
    return taken


def _points(file: Path) -> Float32[np.ndarray, "P 3"]:
    points = pcd.read(file)
    if not len(points):
        raise BrokenData(file, "holds no points")
    return points


def _sweep(sequence: FrameSequence, t: int, agent: int) -> Sweep:
    world_T_lidar, place, scene = sequence.world_T_lidar[t, agent], sequence.place[t, agent], sequence.scene
    origin = np.append(place[:2], world_T_lidar[2, 3] - sequence.ground[t, agent])
    shift = world_T_lidar[:, 3] - [*place[:2], sequence.ground[t, agent]]
    boxes = standing(scene, t, place[:2])
    own = int(scene.connected[agent]) if agent < scene.n_connected else None
    turn = mirrored(world_T_lidar[:, :3])  # takes points as the file stores them
    points, hits = to_world_axes(_points(sequence.files[t][agent]), turn, shift, boxes, own)
    error = sequence.believed[t, agent] - place
    if error.any():
        astray = np.array([[np.cos(error[2]), np.sin(error[2])], [-np.sin(error[2]), np.cos(error[2])]])
        points[:, :2] = points[:, :2] @ astray.astype(np.float32) + error[:2].astype(np.float32)
    return Sweep(points, origin, hits)
