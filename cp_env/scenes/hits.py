"""Which vehicle a return came from, where a data set does not say: the box it lies in."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

MARGIN = 0.05  # m; a box may be this much too tight
CLEARANCE = 0.1  # m; below it, inside a box, lies the road
_CELL = 2.0  # m; of the raster that sorts out the returns far from any box


def count_returns(
    points: Float[np.ndarray, "P 3"],
    centre: Float[np.ndarray, "M 3"],
    size: Float[np.ndarray, "M 3"],
    yaw: Float[np.ndarray, " M"],
) -> Int[np.ndarray, " M"]:
    """Points inside each box; boxes are upright, points and boxes in one frame, a box with NaN holds none.

    Args:
        points: x, y, z; m.
        centre: x, y, z of the middle of each box; m.
        size: length, width, height; m.
        yaw: heading; rad, counter-clockwise.
    """
    hits = np.zeros(len(centre), dtype=np.int64)
    rows = np.flatnonzero(~np.isnan(centre).any(axis=1))
    if not len(rows) or not len(points):
        return hits
    near = points[_near(points, centre[rows, :2], np.hypot(size[rows, 0], size[rows, 1]) / 2 + MARGIN)]
    offset = near[None] - centre[rows, None].astype(points.dtype)
    cos, sin = np.cos(yaw[rows, None]), np.sin(yaw[rows, None])
    along = np.abs(cos * offset[..., 0] + sin * offset[..., 1])
    across = np.abs(cos * offset[..., 1] - sin * offset[..., 0])
    half = size[rows, None] / 2
    inside = (along <= half[..., 0] + MARGIN) & (across <= half[..., 1] + MARGIN)
    inside &= (offset[..., 2] <= half[..., 2] + MARGIN) & (offset[..., 2] >= CLEARANCE - half[..., 2])
    hits[rows] = inside.sum(axis=1)
    return hits


def _near(
    points: Float[np.ndarray, "P 3"], place: Float[np.ndarray, "R 2"], radius: Float[np.ndarray, " R"]
) -> Int[np.ndarray, " Q"]:
    """The points that share a raster cell with the square round any box."""
    low = points[:, :2].min(axis=0)
    shape = np.floor((points[:, :2].max(axis=0) - low) / _CELL).astype(int) + 1
    first = np.floor((place - radius[:, None] - low) / _CELL).astype(int).clip(0)
    last = np.floor((place + radius[:, None] - low) / _CELL).astype(int).clip(-1)
    marked = np.zeros(shape, dtype=bool)
    for (x0, y0), (x1, y1) in zip(first.tolist(), last.tolist(), strict=True):
        marked[x0 : x1 + 1, y0 : y1 + 1] = True
    cell = ((points[:, :2] - low) * (1 / _CELL)).astype(np.int32)
    return np.flatnonzero(marked[cell[:, 0], cell[:, 1]])
