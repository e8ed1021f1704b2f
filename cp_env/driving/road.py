"""The road of a pseudo-closed loop: the ego's recorded path, where it has to wait, and the traffic that replays."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from cp_env.metrics.corridor import Path
from cp_env.types import Scene

SLOWEST = 30 / 3.6
"""Least desired speed; m/s. In a jam the recorded ego never drove as fast as it would."""

NOTICE = 5.0
"""A wait of the recorded ego is known so long before; s."""

STANDING = 1.0
"""The recorded ego waits below this speed; m/s."""

QUEUE = 15.0
"""It waits for a vehicle, not for a light, if one is so near ahead when the wait begins; m."""


@dataclass(frozen=True, kw_only=True)
class Wait:
    """A line at which the ego stands for a while, as at a red light."""

    first: int  # frame of the scene from which on it is known
    last: int  # frame
    along: float  # of the ego's centre on its path; m


@dataclass(eq=False)
class Road:
    """One recording from a frame on, in the world frame."""

    scene: Scene
    start: int  # frame of the scene
    path: Path
    ego: int  # row
    desired: float  # speed on a free road; m/s
    waits: list[Wait]
    ghosts: Float[np.ndarray, "G 2"]  # boxes of the last frame that were no vehicle's; m
    left_out: set[int] = field(default_factory=set)  # rows of vehicles that came through the ego, or appeared on it

    @classmethod
    def of(cls, scene: Scene, start: int) -> Road:
        """The road of the scene's ego from frame `start` on."""
        ego = int(scene.connected[0])
        path = Path.recorded(scene, ego, start)
        step = np.linalg.norm(np.diff(scene.pose[start:, ego, :2], axis=0), axis=1)
        speed = np.append(step, step[-1:] if len(step) else 0.0) / scene.dt
        driven = np.concatenate([[0.0], np.cumsum(step)])
        desired = max(SLOWEST, float(speed.max(initial=0.0)))
        road = cls(scene, start, path, ego, desired, [], np.zeros((0, 2)))
        road.waits = road._waits(speed, driven)
        return road

    @property
    def front(self) -> float:
        """From the ego's centre to its bumper; m."""
        return float(self.scene.size[self.ego, 0]) / 2

    def rows(self, frame: int) -> Int[np.ndarray, " L"]:
        """The vehicles of a frame of the scene that matter: not the ego, nor those that are left out."""
        there = np.isfinite(self.scene.pose[frame, :, 0])
        there[[self.ego, *self.left_out]] = False
        return np.flatnonzero(there)

    def boxes(self, frame: int, rows: Int[np.ndarray, " L"]) -> Float[np.ndarray, "L 5"]:
        """Their boxes in the world frame; m, rad."""
        pose = self.scene.pose[frame, rows]
        return np.concatenate([pose[:, :2], self.scene.size[rows, :2], pose[:, 2:]], axis=1)

    def _waits(self, speed: Float[np.ndarray, " F"], driven: Float[np.ndarray, " F"]) -> list[Wait]:
        """Where the recorded ego stands with nobody ahead. What it waits for is then no vehicle of its lane."""
        slow = np.concatenate([[False], speed < STANDING, [False]])
        begins, ends = np.flatnonzero(slow[1:] & ~slow[:-1]), np.flatnonzero(~slow[1:] & slow[:-1])
        waits = []
        for begin, end in zip(begins.tolist(), ends.tolist(), strict=True):
            first = self.start + begin
            ahead = self.path.ahead(float(driven[begin]), QUEUE + 2 * self.front, self.front)
            if ahead.gaps(self.boxes(first, self.rows(first)))[0].min(initial=np.inf) > QUEUE:
                known, last = first - round(NOTICE / self.scene.dt), self.start + end - 1
                waits.append(Wait(first=known, last=last, along=float(driven[end - 1])))
        return waits
