"""Live traffic that reacts: one scene of a SUMO source, made frame by frame while its ego is driven from outside.

    with open_stage(open_source("sumo:urban?seed=3"), "urban-000000") as stage, stage.traffic() as traffic:
        traffic.step(place, speed)

The simulation that the scene was taken from is run again to the scene's first frame. From there on the ego is where
`step` puts it (SUMO's `moveToXY`, with its speed told), and SUMO moves everyone else, who follow it, brake for it and
yield to it. An ego that is driven as SUMO drove it gives the recorded traffic again, to half a metre (tested): it
is mapped to its lane anew in every frame.

The ego keeps to the path that it drives in the undisturbed simulation, which is run before to learn it. The streets are
furnished as in the recorded scene. Whoever comes within `build.REACH` of the ego is in the scene; vehicles that SUMO
drives through each other are not taken out, as they are in a recording, for nobody knows of it in advance.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from cp_env import lidar
from cp_env.metrics.corridor import Path
from cp_env.scenes.sumo.build import REACH
from cp_env.scenes.sumo.live import Draft, LiveSumo
from cp_env.scenes.sumo.traffic import DT, BoxTracker, Census, running
from cp_env.types import Scene, Sweep

SCOUTED = 90.0
"""So long the undisturbed ego is watched to learn its path; s. A recorded wait at a light takes 40 at most."""

COMFORTABLE = 1.5
"""A line at which the ego would have to brake harder is passed, as one passes a light that turns yellow; m/s².

The comfortable deceleration of the driver model."""

IN_SIGHT = 5.0
"""Who has no priority sees whether the junction is free from so near its line; m. SUMO's own drivers from 4.5 m."""

UNVEILED = 5.0
"""The ego's path shows in the frames to come as if it drove at least so fast; m/s."""


@dataclass(frozen=True, eq=False)
class Stage:
    """A scene that can be driven through again and again: how it was made, and the way of its ego."""

    source: LiveSumo
    draft: Draft
    way: Way

    @property
    def name(self) -> str:
        """Of the scene."""
        return self.draft.built.scene.name

    @contextmanager
    def traffic(self, *, frames: int = 100, connected: int | None = None) -> Iterator[ReactiveTraffic]:
        """The traffic at the first frame. Its simulation ends with the context.

        libsumo holds one simulation a process, so no scene can be loaded meanwhile.

        Args:
            frames: how many are driven, at most.
            connected: how many of the scene's connected vehicles, the ego first; all by default.

        Raises:
            ValueError: the scene has fewer connected vehicles; or SUMO refuses.
        """
        most = len(self.draft.connected)
        if connected is not None and not 1 <= connected <= most:
            raise ValueError(f"scene {self.name!r} has {most} connected vehicles: ask for 1 to {most}, not {connected}")
        with running(self.draft.simulation.command) as sumo:
            yield ReactiveTraffic(self, Replay(sumo, self.draft), frames, connected or most)


@contextmanager
def open_stage(source: LiveSumo, name: str) -> Iterator[Stage]:
    """A scene of live traffic to drive in; the files of its simulation are there until the context ends.

    Raises:
        ValueError: there is no such scene, or SUMO refuses.
    """
    with source.draft(name) as draft:
        with running(draft.simulation.command) as sumo:
            way = Way.scout(Replay(sumo, draft), draft.connected[0])
        yield Stage(source, draft, way)


class ReactiveTraffic:
    """A scene that grows, as a `SceneSource` of this one scene, and the `Traffic` of `cp_env.driving.reactive`.

    Made by `Stage.traffic`. `scene` is a new object after every `step`. Its rows are the connected vehicles, the
    parked ones, and then everyone in the order of coming near.

    The frames to come hold everybody's straight continuation at the speed of now, so that velocities, which are
    differences of poses, are those of the past; the ego's place goes on along its path.
    """

    endless = True

    def __init__(self, stage: Stage, replay: Replay, frames: int, connected: int) -> None:
        draft, way = stage.draft, stage.way
        self._built, self._replay, self._frames = draft.built, replay, frames
        self.name, self.digest = f"{stage.source.name}/reactive", f"{stage.source.digest}/reactive"
        self._ego, self._senders = draft.connected[0], [replay.row(name) for name in draft.connected[:connected]]
        whole, first = draft.built.scene, draft.built.n_moving
        self._parked, self._sizes = whole.pose[0, first:], whole.size[first:]
        self._rows: dict[int, int] = {}  # the scene's row of every tracked vehicle
        world = self._built.to_world(way.pose)
        self._template = replace(whole, connected=np.arange(connected), pose=world[:, None], size=whole.size[:1])
        self.path, self.fastest = Path.recorded(self._template, 0, 0), way.fastest
        self._length = float(np.linalg.norm(np.diff(world[:, :2], axis=0), axis=1).sum())
        self.frame, self.ended, self._along = 0, False, 0.0
        self._seen = [self._near(replay.now, replay.now[self._senders[0]])]
        self._before = {row: self._built.to_world(pose) for row, pose in replay.before.items()}
        self._speed = self._pace()
        self.scene = self._snapshot()

    # -- a source of one scene -------------------------------------------------------------------------------------

    def names(self) -> tuple[str, ...]:
        """The scene."""
        return (self._template.name,)

    def load(self, name: str) -> Scene:
        """The scene as it is now. ValueError for another name."""
        if name != self._template.name:
            raise ValueError(f"unknown scene {name!r}; this traffic is that of {self._template.name!r}")
        return self.scene

    def sweeps(self, scene: Scene, frames: Sequence[int]) -> list[list[Sweep]]:
        """`[frame][agent]`: the connected vehicles in order, then the road-side unit where there is a junction."""
        return lidar.scan([(scene, int(frame)) for frame in frames])

    # -- the traffic -----------------------------------------------------------------------------------------------

    def stop_lines(self) -> list[float]:
        """From the ego's front bumper to the line before the next junction, if it has to wait there; m.

        SUMO knows who may drive: signals, priority, and whether the junction is free. Where the ego has no priority it
        approaches as if it had to stop, until it is near enough to see.
        """
        lane, gap, links = self._replay.ahead(self._ego)
        if not links or lane.startswith(":"):  # in the junction
            return []
        _, priority, free, _, _, state, *_ = links[0]
        waits = state in "ruyY" or not free or (not priority and gap > IN_SIGHT)
        stoppable = self._speed**2 <= 2 * COMFORTABLE * max(gap, 0.0)
        return [gap] if waits and stoppable else []

    def step(self, place: Float[np.ndarray, " 3"], speed: float) -> None:
        """Move the ego there (x, y, yaw of its box; m, rad), at that speed (m/s), and everyone else to the next frame.

        The traffic ends when the ego comes to the end of its way, and when a connected vehicle leaves the streets.
        """
        here, ego = self._built.to_network(np.array(place, dtype=np.float64)), self._senders[0]
        self._before = self._seen[-1]
        self._replay.step(self._ego, here, speed)
        now = self._near(self._replay.now, here)
        now[ego] = np.array(place, dtype=np.float64)
        gone = [row for row in self._senders if row not in self._replay.now]
        now |= {row: self._before[row] for row in gone if row != ego}
        self._along += float(np.linalg.norm(now[ego][:2] - self._before[ego][:2]))
        self._seen.append(now)
        self._speed = speed
        self.frame += 1
        self.ended = bool(gone) or self._along >= self._length or self.frame + 1 >= self._frames
        self.scene = self._snapshot()

    def _near(self, poses: Poses, ego: Float[np.ndarray, " 3"]) -> Poses:
        """Those of the senders and of everyone near the ego, in the world frame."""
        return {
            row: self._built.to_world(pose)
            for row, pose in poses.items()
            if row in self._senders or np.linalg.norm(pose[:2] - ego[:2]) <= REACH
        }

    def _pace(self) -> float:
        """The speed of the ego since the frame before; m/s."""
        ego = self._senders[0]
        return float(np.linalg.norm(self._seen[-1][ego][:2] - self._before[ego][:2])) / DT

    def _snapshot(self) -> Scene:
        """The scene as of now."""
        first = len(self._senders)
        for row in (*self._senders, *self._seen[-1]):
            if row not in self._rows:
                known = len(self._rows)
                self._rows[row] = known if known < first else known + len(self._parked)
        pose = np.full((self._frames, len(self._rows) + len(self._parked), 3), np.nan)
        pose[:, first : first + len(self._parked)] = self._parked
        for frame, poses in zip(pose, self._seen, strict=False):
            frame[[self._rows[row] for row in poses]] = list(poses.values())
        to_come = np.arange(1, self._frames - self.frame)[:, None]
        for row, now in self._seen[-1].items():
            step = np.append(now[:2] - self._before[row][:2], 0.0) if row in self._before else np.zeros(3)
            pose[self.frame + 1 :, self._rows[row]] = now + to_come * step
        rate = np.maximum(self._speed, UNVEILED) * DT
        driven = self._along + self._speed * DT + rate * (to_come[:, 0] - 1)
        for frame, along in zip(pose[self.frame + 1 :], driven, strict=True):
            frame[0] = self.path.place(float(along))
        size = np.empty((pose.shape[1], 3))
        size[first : first + len(self._parked)] = self._sizes
        for row, number in self._rows.items():
            size[number] = self._replay.size(row)
        return replace(self._template, pose=pose, size=size)


Poses = dict[int, Float[np.ndarray, " 3"]]
"""Of tracked vehicles, by their row in the tracker."""


@dataclass(frozen=True, eq=False)
class Way:
    """What the ego drives in the undisturbed simulation."""

    pose: Float[np.ndarray, "F 3"]  # of its box, network frame; m, rad
    fastest: float  # m/s

    @classmethod
    def scout(cls, replay: Replay, ego: str) -> Way:
        """Watch it for `SCOUTED` seconds, or until it leaves the streets."""
        row, poses = replay.row(ego), [replay.now[replay.row(ego)]]
        for _ in range(round(SCOUTED / DT)):
            replay.advance()
            if row not in replay.now:
                break
            poses.append(replay.now[row])
        pose = np.array(poses)
        step = np.linalg.norm(np.diff(pose[:, :2], axis=0), axis=1)
        return cls(pose, float(step.max(initial=0.0)) / DT)


class Replay:
    """The simulation of a draft, run again up to the scene's first frame, and then on, step by step.

    `now` and `before` are the boxes of all vehicles in this frame and the one before, by row, in the network's frame.
    """

    def __init__(self, sumo: Any, draft: Draft) -> None:
        self.sumo, self._census = sumo, Census(sumo)
        self._tracker = BoxTracker(draft.simulation.jump)
        self.before: Poses = {}
        self.now: Poses = {}
        planned = draft.simulation
        for _ in range(round(planned.warm_up / DT) + draft.stretch * round(planned.seconds / DT)):
            sumo.simulationStep()
        for _ in range(draft.start + 1):
            self.advance()
        if not self.before:  # the scene begins with the stretch
            self.before = {row: self._back(row, pose) for row, pose in self.now.items()}

    def advance(self) -> None:
        """One frame."""
        self.sumo.simulationStep()
        poses = self._tracker.follow(self._census.frame(), self._census.measures())
        self.before, self.now = self.now, {row: np.array(pose) for row, pose in poses.items()}

    def step(self, name: str, place: Float[np.ndarray, " 3"], speed: float) -> None:
        """One frame, in which a vehicle's box comes to that place, with that speed."""
        x, y, yaw = place.tolist()
        half = float(self.size(self.row(name))[0]) / 2
        front = x + half * np.cos(yaw), y + half * np.sin(yaw)
        self.sumo.vehicle.moveToXY(name, "", -1, *front, float(90 - np.rad2deg(yaw)), keepRoute=1)
        self.sumo.vehicle.setPreviousSpeed(name, speed)
        self.advance()

    def ahead(self, name: str) -> tuple[str, float, list[tuple[Any, ...]]]:
        """The lane that a vehicle is on, how far its end is (m), and SUMO's links after it.

        A link is (lane, priority, whether it is free, foe, inner lane, state of the signal, direction, length).
        """
        if name not in self.sumo.vehicle.getIDList():
            return "", 0.0, []
        lane = self.sumo.vehicle.getLaneID(name)
        gap = self.sumo.lane.getLength(lane) - self.sumo.vehicle.getLanePosition(name)
        return lane, float(gap), list(self.sumo.vehicle.getNextLinks(name))

    def row(self, name: str) -> int:
        """The row that a vehicle was given last."""
        return len(self._tracker.names) - 1 - self._tracker.names[::-1].index(name)

    def size(self, row: int) -> Float[np.ndarray, " 3"]:
        """Length, width, height; m."""
        measured: Float[np.ndarray, " 3"] = self._census.measures()[self._tracker.kinds[row]]
        return measured

    def _back(self, row: int, pose: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
        """Where a vehicle was a frame ago, at its speed of now."""
        back = self.sumo.vehicle.getSpeed(self._tracker.names[row]) * DT
        return pose - back * np.array([np.cos(pose[2]), np.sin(pose[2]), 0.0])
