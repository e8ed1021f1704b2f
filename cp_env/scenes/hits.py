"""Which vehicle a return came from, where a data set does not say: the box it lies in."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from cp_env.types import Scene, Sweep

MARGIN = 0.05  # m; a box may be this much too tight
CLEARANCE = 0.1  # m; below it, inside a box, lies the road
_CELL = 2.0  # m; of the raster by which points are looked up


def count_returns(
    points: Float[np.ndarray, "P 3"],
    centre: Float[np.ndarray, "M 3"],
    size: Float[np.ndarray, "M 3"],
    yaw: Float[np.ndarray, " M"],
    margin: float = MARGIN,
) -> Int[np.ndarray, " M"]:
    """Points inside each box; boxes are upright, points and boxes in one frame, a box with NaN holds none.

    Args:
        points: x, y, z; m.
        centre: x, y, z of the middle of each box; m.
        size: length, width, height; m.
        yaw: heading; rad, counter-clockwise.
        margin: m, by which a box may be too tight.
    """
    rows = np.flatnonzero(~np.isnan(centre).any(axis=1))
    if not len(rows) or not len(points):
        return np.zeros(len(centre), dtype=np.int64)
    radius = np.hypot(size[rows, 0], size[rows, 1]) / 2 + margin
    point, box = _pairs(points[:, :2], centre[rows, :2], radius)
    row = rows[box]
    dx, dy, dz = (points[point] - centre[row].astype(points.dtype)).T
    cos, sin = np.cos(yaw)[row], np.sin(yaw)[row]
    half = (size / 2)[row]
    inside = (np.abs(cos * dx + sin * dy) <= half[:, 0] + margin) & (np.abs(cos * dy - sin * dx) <= half[:, 1] + margin)
    inside &= (dz <= half[:, 2] + margin) & (dz >= CLEARANCE - half[:, 2])
    return np.bincount(row[inside], minlength=len(centre))


def beside(
    points: Float[np.ndarray, "P 3"], box: Float[np.ndarray, " 5"], margin: float = MARGIN
) -> Bool[np.ndarray, " P"]:
    """Which points do not lie over or under the footprint (x, y, length, width, yaw) of the vehicle that took them."""
    offset = points[:, :2] - box[:2].astype(points.dtype)
    cos, sin = np.cos(box[4]), np.sin(box[4])
    along, across = cos * offset[:, 0] + sin * offset[:, 1], cos * offset[:, 1] - sin * offset[:, 0]
    return (np.abs(along) > box[2] / 2 + margin) | (np.abs(across) > box[3] / 2 + margin)


def returns_of(scene: Scene, frame: int, sweep: Sweep) -> Int[np.ndarray, " M"]:
    """Returns from each of the scene's vehicles: what the source says, or else those inside its box."""
    if sweep.hits is not None:
        return sweep.hits
    middle = np.column_stack([scene.pose[frame, :, :2] - sweep.origin[:2], scene.size[:, 2] / 2])
    return count_returns(sweep.points, middle, scene.size, scene.pose[frame, :, 2])


def _pairs(
    points: Float[np.ndarray, "P 2"], place: Float[np.ndarray, "R 2"], radius: Float[np.ndarray, " R"]
) -> tuple[Int[np.ndarray, " Q"], Int[np.ndarray, " Q"]]:
    """Every point with every box whose bounding square shares a raster cell with it: numbers of both.

    Points are sorted by cell, row by row, so that what a square covers of a row of cells is one run of points.
    """
    low = points.min(axis=0)
    cell = ((points - low) / _CELL).astype(np.int64)
    width, height = cell.max(axis=0) + 1
    number = cell[:, 1] * width + cell[:, 0]
    small = np.min_scalar_type(width * height)  # numbers of 16 bits are sorted by their digits, ten times as fast
    order = np.argsort(number.astype(small), kind="stable")
    begins = np.concatenate([[0], np.cumsum(np.bincount(number, minlength=width * height))])
    first = np.floor((place - radius[:, None] - low) / _CELL).astype(np.int64)
    last = np.floor((place + radius[:, None] - low) / _CELL).astype(np.int64)
    first, last = first.clip(0), np.minimum(last, (width - 1, height - 1))
    extent = (last - first + 1).clip(0)
    strips = np.where(extent[:, 0] > 0, extent[:, 1], 0)
    box, line = _runs(strips)
    start = (first[box, 1] + line) * width
    begin = begins[start + first[box, 0]]
    strip, offset = _runs(begins[start + last[box, 0] + 1] - begin)
    return order[begin[strip] + offset], box[strip]


def _runs(lengths: Int[np.ndarray, " N"]) -> tuple[Int[np.ndarray, " Q"], Int[np.ndarray, " Q"]]:
    """For runs of these lengths, one after the other: the number of the run, and the place in it."""
    run = np.repeat(np.arange(len(lengths)), lengths)
    return run, np.arange(len(run)) - np.repeat(np.cumsum(lengths) - lengths, lengths)
