"""Moving traffic: SUMO drives trips from stub to stub through a network, and we note where everyone is.

SUMO gives the middle of the front bumper and clockwise degrees from north; we keep box centres and radians from east.
"""

from __future__ import annotations

import threading
import xml.etree.ElementTree as ET
from collections.abc import Generator, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from cp_env.scenes.sumo.network import NEEDS_SUMO, NO_CARS, Streets
from cp_env.scenes.sumo.vehicle_sizes import draw_sizes

DT = 0.2  # s: 5 Hz
AXLE = 0.8  # of its length lies a vehicle's rear axle behind its front bumper
JUMP = 4.0  # m a frame: nobody drives that fast here
N_TYPES = 60  # vehicles of one type are twins; a scene shows some dozens

_ALWAYS = [
    "--step-length", str(DT), "--time-to-teleport", "60", "--collision.action", "none",
    "--no-step-log", "--no-warnings", "--ignore-route-errors", "--remote-port", "0",
]  # fmt: skip
_ONE_AT_A_TIME = threading.Lock()

Seen = dict[str, tuple[float, float, float, str]]
"""x, y of the front bumper, SUMO's angle and the row of the sizes, of every vehicle in a frame."""


@dataclass(frozen=True)
class Tracks:
    """The vehicles that drove in the frames kept; NaN where absent. Poses of box centres in the network's frame."""

    pose: Float[np.ndarray, "T V 3"]
    size: Float[np.ndarray, "V 3"]
    left_out: frozenset[str] = frozenset()  # SUMO's classes that drove too and are no cars
    names: tuple[str, ...] = ()  # SUMO's, of each row; two rows have one name where SUMO moved a vehicle at once

    def of(self, rows: Int[np.ndarray, " K"] | Bool[np.ndarray, " V"]) -> Tracks:
        """Those of some of the vehicles."""
        names = tuple(np.array(self.names, dtype=object)[rows].tolist()) if self.names else ()
        return Tracks(self.pose[:, rows], self.size[rows], self.left_out, names)


@dataclass(frozen=True, kw_only=True)
class Simulation:
    """A run of SUMO that can be repeated: the same arguments give the same traffic."""

    command: tuple[str, ...]  # arguments of `sumo`
    warm_up: float  # s simulated before the first stretch
    seconds: float  # s of each stretch
    most: float  # s of all stretches; they end earlier where nothing drives or is to come
    jump: float = JUMP  # a vehicle that moves farther in a frame, m, was moved by SUMO itself

    def stretches(self) -> Generator[Tracks, None, None]:
        """See the function of that name."""
        options = {"warm_up": self.warm_up, "seconds": self.seconds, "most": self.most, "jump": self.jump}
        return stretches(list(self.command), **options)


def drive(
    streets: Streets,
    folder: Path,
    rng: np.random.Generator,
    *,
    crowd: int,
    warm_up: float = 90.0,
    seconds: float = 90.0,
) -> Tracks:
    """Simulate `warm_up` + `seconds` s with at most `crowd` vehicles at once; the last `seconds` are kept."""
    with closing(prepare(streets, folder, rng, crowd=crowd, warm_up=warm_up, seconds=seconds).stretches()) as found:
        return next(found)


def prepare(
    streets: Streets, folder: Path, rng: np.random.Generator, *, crowd: int, warm_up: float, seconds: float
) -> Simulation:
    """The simulation of trips that are drawn now and written to `folder`, with one stretch."""
    _simulator()  # before anything is written
    sizes = draw_sizes(N_TYPES, rng, parked=False)
    routes = folder / "trips.rou.xml"
    _write_trips(routes, streets, sizes, rng, horizon=warm_up + seconds)
    command = (
        "-n", str(streets.net), "-r", str(routes), "--seed", str(int(rng.integers(1 << 30))),
        "--max-num-vehicles", str(crowd), "--lanechange.duration", "3", "--default.speeddev", "0",
    )  # fmt: skip
    return Simulation(command=command, warm_up=warm_up, seconds=seconds, most=seconds)


def watch(command: list[str], *, warm_up: float, seconds: float, jump: float = JUMP) -> Tracks:
    """The first of the `stretches` of `command`."""
    with closing(stretches(command, warm_up=warm_up, seconds=seconds, most=seconds, jump=jump)) as found:
        return next(found)


def stretches(
    command: list[str], *, warm_up: float, seconds: float, most: float, jump: float = JUMP
) -> Generator[Tracks, None, None]:
    """Run `sumo` by `command` at 5 Hz; all cars, vans, lorries and buses of one stretch of the drive after another.

    libsumo holds one simulation a process: this one ends when the generator is closed, and waits for one in another
    thread.

    Args:
        command: arguments of `sumo`.
        warm_up: s simulated before the first stretch.
        seconds: s of each stretch.
        most: s of all stretches; they end earlier where nothing drives or is to come.
        jump: a vehicle that moves farther in a frame, m, was moved by SUMO itself, and goes on as another one.

    Yields:
        The tracks of the next stretch.

    Raises:
        ImportError: SUMO is not installed.
        ValueError: SUMO refuses the command; the message says why, as far as SUMO does.
    """
    with running(command) as sumo:
        census = Census(sumo)
        for _ in range(round(warm_up / DT)):
            sumo.simulationStep()
        for _ in range(round(most / seconds)):
            frames = []
            for _ in range(round(seconds / DT)):
                sumo.simulationStep()
                frames.append(census.frame())
            yield replace(_tracks(frames, census.measures(), jump), left_out=frozenset(census.left_out))
            if not sumo.simulation.getMinExpectedNumber():
                return


@contextmanager
def running(command: Sequence[str]) -> Iterator[Any]:
    """libsumo with a simulation at 5 Hz that ends with the context; one at a time in a process.

    Raises:
        ImportError: SUMO is not installed.
        ValueError: SUMO refuses the command, or a call inside the context; the message says why, as far as SUMO does.
    """
    sumo = _simulator()
    with _ONE_AT_A_TIME:
        try:
            sumo.start(["sumo", *command, *_ALWAYS])
            yield sumo
        except (sumo.TraCIException, sumo.FatalTraCIError) as error:
            raise ValueError(
                f"SUMO refused `sumo {' '.join(command)}`: {error} (more stands on the standard error stream)"
            ) from error
        finally:
            sumo.close()


class Census:
    """The road vehicles of a simulation, step by step."""

    def __init__(self, sumo: Any) -> None:
        self._sumo = sumo
        self._kinds: dict[str, int] = {}  # row of `_sizes`, or -1, of each vehicle type met
        self._sizes: list[tuple[float, float, float]] = []
        self.left_out: set[str] = set()

    def measures(self) -> Float[np.ndarray, "K 3"]:
        """Length, width, height of the types met."""
        return np.array(self._sizes).reshape(-1, 3)

    def frame(self) -> Seen:
        """x, y of the front bumper, angle and type of everyone who drives now."""
        sumo, frame = self._sumo, {}
        for name in sumo.vehicle.getIDList():
            kind = sumo.vehicle.getTypeID(name)
            if kind not in self._kinds:
                self._kinds[kind] = self._measured(kind)
            if self._kinds[kind] >= 0:
                frame[name] = (*sumo.vehicle.getPosition(name), sumo.vehicle.getAngle(name), str(self._kinds[kind]))
        return frame

    def _measured(self, kind: str) -> int:
        measure = self._sumo.vehicletype
        if measure.getVehicleClass(kind) in NO_CARS:
            self.left_out.add(measure.getVehicleClass(kind))
            return -1
        self._sizes.append((measure.getLength(kind), measure.getWidth(kind), measure.getHeight(kind)))
        return len(self._sizes) - 1


def _write_trips(
    path: Path, streets: Streets, sizes: Float[np.ndarray, "K 3"], rng: np.random.Generator, horizon: float
) -> None:
    root = ET.Element("routes")
    write_types(root, sizes, rng)
    for k, depart in enumerate(np.arange(0, horizon, 0.35)):
        source = streets.sources[rng.integers(len(streets.sources))]
        sinks = [edge for edge in streets.sinks if edge.split("-")[::-1] != source.split("-")]
        trip = {"id": f"v{k}", "from": source, "to": sinks[rng.integers(len(sinks))]}
        kind = str(rng.integers(len(sizes)))
        start = {"depart": f"{depart:.2f}", "departLane": "random", "departSpeed": "max", "departPos": "0"}
        ET.SubElement(root, "trip", {**trip, **start}, type=kind)
    ET.ElementTree(root).write(path)


def write_types(root: ET.Element, sizes: Float[np.ndarray, "K 3"], rng: np.random.Generator) -> None:
    """One vehicle type a size, called by its number, each with a driver of its own."""
    for k, (length, width, height) in enumerate(sizes):
        heavy = length > 6.5
        ET.SubElement(
            root, "vType", id=str(k), length=f"{length:.2f}", width=f"{width:.2f}", height=f"{height:.2f}", sigma="0.3",
            minGap=f"{rng.uniform(1.5, 2.5):.2f}", accel="1.3" if heavy else "2.2", decel="3.5", tau="1.1",
            speedFactor=f"{rng.uniform(0.85, 1.0):.2f}", lcStrategic="2",
        )  # fmt: skip


class BoxTracker:
    """The box of every vehicle from frame to frame, its rear axle drawn behind its front bumper as on a real road.

    SUMO turns a vehicle by its lane, which jumps between lanes and at junctions; a rear axle that follows does not.
    A vehicle that SUMO moved elsewhere at once (a "teleport" out of a jam) goes on as another one.

    Args:
        jump: a vehicle that moves farther in a frame, m, was moved by SUMO.
    """

    def __init__(self, jump: float = JUMP) -> None:
        self.names: list[str] = []  # of each row
        self.kinds: list[int] = []  # row of the sizes, of each row
        self._jump = jump
        self._rows: dict[str, int] = {}  # of those in the last frame
        self._front: dict[str, tuple[float, float]] = {}
        self._axle: dict[str, tuple[float, float]] = {}

    def follow(self, frame: Seen, sizes: Float[np.ndarray, "K 3"]) -> dict[int, tuple[float, float, float]]:
        """x, y, yaw of the box centres of the next frame, by row; new vehicles get new rows."""
        rows, poses = {}, {}
        for name in sorted(frame):
            x, y, angle, kind = frame[name]
            length = sizes[int(kind), 0]
            yaw = np.pi / 2 - np.deg2rad(angle)
            if name not in self._rows or _far(self._front[name], (x, y), self._jump):
                rows[name] = len(self.kinds)
                self.kinds.append(int(kind))
                self.names.append(name)
            else:
                rows[name] = self._rows[name]
                yaw = np.arctan2(y - self._axle[name][1], x - self._axle[name][0])
            self._front[name] = x, y
            self._axle[name] = x - AXLE * length * np.cos(yaw), y - AXLE * length * np.sin(yaw)
            poses[rows[name]] = x - length / 2 * np.cos(yaw), y - length / 2 * np.sin(yaw), yaw
        self._rows = rows
        return poses


def _tracks(frames: list[Seen], sizes: Float[np.ndarray, "K 3"], jump: float = JUMP) -> Tracks:
    """The boxes of all vehicles in all frames; see `BoxTracker`."""
    tracker = BoxTracker(jump)
    poses = [tracker.follow(frame, sizes) for frame in frames]
    pose = np.full((len(frames), len(tracker.kinds), 3), np.nan)
    for row, here in zip(pose, poses, strict=True):
        if here:
            row[list(here)] = list(here.values())
    return Tracks(pose, sizes[tracker.kinds], names=tuple(tracker.names))


def _far(a: tuple[float, float], b: tuple[float, float], jump: float) -> bool:
    return bool(abs(a[0] - b[0]) + abs(a[1] - b[1]) > jump)


def version() -> str:
    """The version of SUMO that is installed.

    Raises:
        ImportError: none is; the message says how to get it.
    """
    _simulator()
    return metadata.version("libsumo")


def _simulator() -> Any:
    try:
        import libsumo
    except ImportError as error:
        raise ImportError(NEEDS_SUMO) from error
    return libsumo
