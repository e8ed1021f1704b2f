"""The vehicle that a return came from, where a data set does not say: the box it lies in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from cp_env.types import Scene, Sweep

MARGIN = 0.05  # m; a box may be this much too tight
CLEARANCE = 0.1  # m; below it, inside a box, lies the road
_CELL = 1.0  # m; of the raster by which points are looked up
_SLACK = 0.01  # m; more than single precision rounds away
BLOCK = 8192  # points looked up at once: what is made of them stays in the processor's cache


def count_returns(
    points: Float[np.ndarray, "P 3"], boxes: Float[np.ndarray, "M 7"], margin: float = MARGIN
) -> Int[np.ndarray, " M"]:
    """Points inside each box; boxes are upright, points and boxes in one frame, a box with NaN holds none.

    Args:
        points: x, y, z; m.
        boxes: x, y, z of the middle, length, width, height, yaw; m, rad counter-clockwise.
        margin: m, by which a box may be too tight.
    """
    rows = np.flatnonzero(~np.isnan(boxes).any(axis=1))
    hits = np.zeros(len(boxes), dtype=np.int64)
    if not len(rows) or not len(points):
        return hits
    columns = np.ascontiguousarray(points.T)  # numpy is several times as fast on runs of memory
    boxes = boxes[rows]
    place, half = boxes[:, :3].T.astype(points.dtype), boxes[:, 3:6].T / 2
    cos, sin = np.cos(boxes[:, 6]), np.sin(boxes[:, 6])
    raster = Raster.of(boxes, columns, margin)
    for begin in range(0, len(points), BLOCK):
        block = columns[:, begin : begin + BLOCK]
        point, box = raster.pairs(block)
        x, y, z = (block[k].take(point) - place[k].take(box) for k in range(3))
        length, width, height = (half[k].take(box) for k in range(3))
        c, s = cos.take(box), sin.take(box)
        inside = (z <= height + margin) & (z >= CLEARANCE - height)
        inside &= (np.abs(c * x + s * y) <= length + margin) & (np.abs(c * y - s * x) <= width + margin)
        hits[rows] += np.bincount(box[inside], minlength=len(rows))
    return hits


def to_world_axes(
    points: Float[np.ndarray, "P 3"],
    turn: Float[np.ndarray, "3 3"],
    shift: Float[np.ndarray, " 3"],
    boxes: Float[np.ndarray, "M 7"],
    own: int | None,
    margin: float = MARGIN,
) -> tuple[Float[np.ndarray, "Q 3"], Int[np.ndarray, " M"]]:
    """A sensor's points along the world's axes from the place of its carrier, and how many lie in each vehicle's box.

    Args:
        points: as the sensor has them; m. Those over or under the carrier itself are left out.
        turn: from the sensor's axes to the world's.
        shift: of the sensor from that place; m.
        boxes: x, y, z, length, width, height, yaw of all vehicles, from that place; NaN of those that are absent.
        own: which of them is the carrier; none under a road-side unit.
        margin: m, by which a box may be too tight.
    """
    columns = turn.astype(points.dtype) @ points.T
    columns += shift.astype(points.dtype)[:, None]
    if own is not None:
        columns = columns.compress(_outside(columns[:2], boxes[own, [0, 1, 3, 4, 6]], margin), axis=1)
    hits = count_returns(columns.T, boxes, margin)
    return np.stack(tuple(columns), axis=1), hits


def _outside(
    points: Float[np.ndarray, "2 P"], footprint: Float[np.ndarray, " 5"], margin: float
) -> Bool[np.ndarray, " P"]:
    """Which points do not lie over or under a footprint (x, y, length, width, yaw)."""
    place, side, yaw = footprint[:2], footprint[2:4] / 2 + margin, footprint[4]
    x, y = points - place[:, None].astype(points.dtype)
    near = np.flatnonzero(np.maximum(np.abs(x), np.abs(y)) < np.hypot(*side) + _SLACK)
    x, y, cos, sin = x[near], y[near], np.cos(yaw), np.sin(yaw)
    outside = np.ones(points.shape[1], dtype=np.bool_)
    outside[near] = (np.abs(cos * x + sin * y) > side[0]) | (np.abs(cos * y - sin * x) > side[1])
    return outside


def standing(scene: Scene, frame: int, place: Float[np.ndarray, " 2"]) -> Float[np.ndarray, "M 7"]:
    """The boxes of a scene's vehicles on level ground: x, y, z from `place`, length, width, height, yaw; m, rad."""
    pose = scene.pose[frame]
    return np.column_stack([pose[:, :2] - place, scene.size[:, 2] / 2, scene.size, pose[:, 2]])


def returns_of(scene: Scene, frame: int, sweep: Sweep) -> Int[np.ndarray, " M"]:
    """Returns from each of the scene's vehicles: what the source says, or else those inside its box."""
    if sweep.hits is not None:
        return sweep.hits
    return count_returns(sweep.points, standing(scene, frame, sweep.origin[:2]))


@dataclass(frozen=True)
class Raster:
    """Which boxes a point may lie in, by the cell it falls in: those whose bounding squares share it."""

    low: Float[np.ndarray, "3 1"]
    high: Float[np.ndarray, "3 1"]
    width: int  # cells in a row
    begin: Int[np.ndarray, " C"]  # of each cell's boxes
    count: Int[np.ndarray, " C"]
    box: Int[np.ndarray, " K"]  # cell by cell

    @classmethod
    def of(cls, boxes: Float[np.ndarray, "R 7"], points: Float[np.ndarray, "3 P"], margin: float) -> Raster:
        """It spans what boxes and points both reach, and no more: either may have one that is far astray."""
        place, half = boxes[:, :3], boxes[:, 3:6] / 2 + margin + _SLACK
        radius = np.hypot(half[:, 0], half[:, 1])
        reach = np.column_stack([radius, radius, half[:, 2]])
        low = np.maximum((place - reach).min(axis=0), points.min(axis=1))
        high = np.minimum((place + reach).max(axis=0), points.max(axis=1))
        low[2] = max(low[2], (place[:, 2] - boxes[:, 5] / 2).min() + CLEARANCE - _SLACK)
        width, height = (np.maximum(high - low, 0)[:2] / _CELL).astype(np.int64) + 2
        first = np.floor((place[:, :2] - radius[:, None] - low[:2]) / _CELL).astype(np.int64).clip(0)
        last = np.floor((place[:, :2] + radius[:, None] - low[:2]) / _CELL).astype(np.int64)
        columns, lines = (np.minimum(last, (width - 1, height - 1)) - first + 1).clip(0).T
        box, line = _runs(np.where(columns > 0, lines, 0))
        strip, offset = _runs(columns[box])
        cell = ((first[box, 1] + line) * width + first[box, 0])[strip] + offset
        count = np.bincount(cell, minlength=width * height)
        order = np.argsort(cell, kind="stable")
        low, high = (bound.astype(points.dtype)[:, None] for bound in (low, high))
        return cls(low, high, int(width), np.cumsum(count) - count, count, box[strip][order])

    def pairs(self, points: Float[np.ndarray, "3 P"]) -> tuple[Int[np.ndarray, " Q"], Int[np.ndarray, " Q"]]:
        """Numbers of points, and with each of a box that may hold it."""
        near = np.flatnonzero(((points >= self.low) & (points <= self.high)).all(axis=0))
        column, line = ((points[:2].take(near, axis=1) - self.low[:2]) / _CELL).astype(np.int64)
        cell = line * self.width + column
        run, offset = _runs(self.count.take(cell))
        return near.take(run), self.box.take(self.begin.take(cell).take(run) + offset)


def _runs(lengths: Int[np.ndarray, " N"]) -> tuple[Int[np.ndarray, " Q"], Int[np.ndarray, " Q"]]:
    """For runs of these lengths, one after the other: the number of the run, and the place in it."""
    run = np.repeat(np.arange(len(lengths)), lengths)
    return run, np.arange(len(run)) - np.repeat(np.cumsum(lengths) - lengths, lengths)
