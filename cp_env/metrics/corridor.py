"""The ego's corridor: the band that it is going to sweep, 2.2 m wide along its recorded path.

Convention: `along` is the distance from the ego's centre along the path; m. A gap is measured from the ego's front
bumper to the nearest part of a box in the corridor; m.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from cp_env.types import Scene

WIDTH = 2.2
"""Of the corridor; m."""

HORIZON = 5.0
"""Time that the corridor looks ahead; s."""

REACH = 30.0
"""The corridor is at least so long, from the front bumper; m. It is about as far as the ego perceives."""

STRAIGHT = 200.0
"""Length by which a recorded path is continued straight ahead; m."""

SAME = 1e-3
"""Steps up to this length are none: the vehicle stands; m."""

_FORE, _SIDE = (part.ravel() for part in np.meshgrid(np.linspace(-0.5, 0.5, 9), [-0.5, 0.0, 0.5]))


@dataclass(frozen=True, eq=False)
class Path:
    """A polyline that a vehicle's centre follows."""

    points: Float[np.ndarray, "P 2"]  # m; at least two, none equal to its neighbour
    along: Float[np.ndarray, " P"]  # distance from the first; m
    yaw: Float[np.ndarray, " P"]  # the vehicle's heading there, without jumps of 2π; rad

    @classmethod
    def recorded(cls, scene: Scene, row: int, start: int) -> Path:
        """What the vehicle of that row drives from frame `start` on, in the world frame.

        Where the recording ends it goes straight on, along the last heading: our choice.
        """
        pose = scene.pose[start:, row]
        step = np.linalg.norm(np.diff(pose[:, :2], axis=0), axis=1)
        driven = pose[np.concatenate([[True], step > SAME])]
        heading = np.array([np.cos(pose[-1, 2]), np.sin(pose[-1, 2])])
        points = np.concatenate([driven[:, :2], [driven[-1, :2] + STRAIGHT * heading]])
        length = np.linalg.norm(np.diff(points, axis=0), axis=1)
        return cls(points, np.concatenate([[0.0], np.cumsum(length)]), np.unwrap([*driven[:, 2], pose[-1, 2]]))

    def place(self, along: float) -> Float[np.ndarray, " 3"]:
        """x, y and heading at that distance; m, rad."""
        x, y = self.points.T
        return np.array([np.interp(along, self.along, part) for part in (x, y, self.yaw)])

    def ahead(self, along: float, reach: float, front: float) -> Corridor:
        """The corridor of a vehicle whose centre is at `along`.

        Args:
            along: m.
            reach: length of the corridor from there; m.
            front: from the vehicle's centre to its front bumper; m.
        """
        inside = (self.along > along + SAME) & (self.along < along + reach - SAME)
        ends = [self.place(along)[:2]], [self.place(along + reach)[:2]]
        return Corridor(np.concatenate([ends[0], self.points[inside], ends[1]]), front)


class _Legs(NamedTuple):
    """The straight pieces of a path, column by column."""

    x: Float[np.ndarray, " P"]  # where each begins; m
    y: Float[np.ndarray, " P"]
    east: Float[np.ndarray, " P"]  # its direction, of length 1
    north: Float[np.ndarray, " P"]
    length: Float[np.ndarray, " P"]  # m
    begin: Float[np.ndarray, " P"]  # along the path; m
    heading: Float[np.ndarray, "P 2"]  # the direction again, as rows


@dataclass(frozen=True, eq=False)
class Corridor:
    """The band along a path that begins at the ego's centre."""

    points: Float[np.ndarray, "P 2"]  # m
    front: float  # from the ego's centre to its front bumper; m

    @classmethod
    def recorded(cls, scene: Scene, frame: int, row: int, origin: Float[np.ndarray, " 2"], speed: float) -> Corridor:
        """The corridor of a recorded vehicle, in the frame whose origin in the world is given.

        It reaches as far as the vehicle drives in the next `HORIZON` seconds, or would at its speed of now if that is
        farther, and at least `REACH` beyond the bumper. With the recorded path alone a vehicle that brakes for a car
        would not have that car in its corridor, and one that stands would have none: our reading.

        Args:
            scene: the scene.
            frame: number of the frame.
            row: of the vehicle.
            origin: m.
            speed: of the vehicle now; m/s.
        """
        path, front = Path.recorded(scene, row, frame), float(scene.size[row, 0]) / 2
        ahead = scene.pose[frame : frame + round(HORIZON / scene.dt) + 1, row, :2]
        driven = float(np.linalg.norm(np.diff(ahead, axis=0), axis=1).sum())
        whole = path.ahead(0.0, min(max(driven, HORIZON * speed, REACH + front), float(path.along[-1])), front)
        return cls(whole.points - origin, front)

    def project(
        self, points: Float[np.ndarray, "Q 2"]
    ) -> tuple[Float[np.ndarray, " Q"], Float[np.ndarray, " Q"], Float[np.ndarray, "Q 2"]]:
        """The nearest place on the path: how far along it, how far from it (m), and the path's direction there.

        Behind the first place the distance along the path is negative, and beyond the last it exceeds the length.
        """
        legs = self._legs
        east, north = points[:, 0, None] - legs.x, points[:, 1, None] - legs.y
        forward = east * legs.east + north * legs.north
        inside = np.minimum(np.maximum(forward, 0.0), legs.length)
        east -= inside * legs.east
        north -= inside * legs.north
        across = np.sqrt(east * east + north * north)
        nearest, rows = across.argmin(axis=1), np.arange(len(points))
        along = legs.begin[nearest] + inside[rows, nearest]
        along = np.where((nearest == 0) & (forward[:, 0] < 0), forward[:, 0], along)
        beyond = (nearest == len(legs.length) - 1) & (forward[:, -1] > legs.length[-1])
        along = np.where(beyond, legs.begin[-1] + forward[:, -1], along)
        return along, across[rows, nearest], legs.heading[nearest]

    @cached_property
    def _legs(self) -> _Legs:
        step = np.diff(self.points, axis=0)
        length = np.linalg.norm(step, axis=1)
        heading = step / length[:, None]
        begin = np.concatenate([[0.0], np.cumsum(length)[:-1]])
        (x, y), (east, north) = self.points[:-1].T.copy(), heading.T.copy()
        return _Legs(x, y, east, north, length, begin, heading)

    @cached_property
    def length(self) -> float:
        """Of the path; m."""
        return float(self._legs.length.sum())

    def gaps(self, boxes: Float[np.ndarray, "L 5"]) -> tuple[Float[np.ndarray, " L"], Float[np.ndarray, "L 2"]]:
        """How far each box is ahead of the front bumper, and the path's direction there.

        A box lies in the corridor if one of 9 x 3 points of it does; the gap of others is infinite. The gap of a box
        that the ego touches is 0.
        """
        gap, direction = np.full(len(boxes), np.inf), np.zeros((len(boxes), 2))
        if not len(boxes):
            return gap, direction
        centre, half = boxes[:, :2].astype(np.float64), 0.5 * np.hypot(boxes[:, 2], boxes[:, 3])
        _, away, direction = self.project(centre)
        close = np.flatnonzero(away <= WIDTH / 2 + half)
        if not len(close):
            return gap, direction
        cos, sin = np.cos(boxes[close, 4, None]), np.sin(boxes[close, 4, None])
        x, y = boxes[close, 2, None] * _FORE, boxes[close, 3, None] * _SIDE
        points = centre[close, None] + np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
        along, across, heading = self.project(points.reshape(-1, 2))
        inside = (across <= WIDTH / 2) & (along > 0) & (along <= self.length)
        along = np.where(inside, along, np.inf).reshape(len(close), -1)
        first, rows = along.argmin(axis=1), np.arange(len(close))
        gap[close] = np.maximum(along[rows, first] - self.front, 0.0)
        direction[close] = heading.reshape(len(close), -1, 2)[rows, first]
        return gap, direction
