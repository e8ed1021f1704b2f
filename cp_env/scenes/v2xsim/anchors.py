"""coperception's detection grids: voxels, anchors, and the box code of the targets stored with them.

Source: the public coperception code (`Config.py`, `obj_util.py`), read for its conventions.

Convention:
    voxel    (ix, iy, iz); the point is its middle in the sensor's frame. The lowest slice begins at a whole multiple of
             its height at or below the extent's floor: -3 m becomes -3.2 m.
    target   lies in the sensor's frame mirrored, u = -x, v = y: the preprocessing negates x of the boxes, and the data
             set turns the voxels to match when it loads them. The files hold the voxels unmirrored.
    anchor   cell (i, j) of the target maps is centred at u = u(j), v = v(i); six anchors of (width, length, φ) a cell.
    code     ((ua - u) / w, (va - v) / l, ln(wa / w), ln(la / l), sin(φ - φa), cos(φ - φa)), where φ = yaw + π/2: angles
             of the mirrored frame turn clockwise.
    A car of 2 × 4 m at (12, 5), yaw 0.4, is (u, v) = (-12, 5), φ = 1.97: in cell (147, 79), whose middle is
    (-12.125, 4.875), its first anchor (2, 4, 0) gets the code (-0.0625, -0.03125, 0, 0, 0.92106, -0.38942).
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Bool, Float, Int

EXTENT = 32.0  # m; grids reach so far to each side
CELL, SLICE = 0.25, 0.4  # m
CELLS, SLICES = 256, 13
FLOOR = {True: -8.0, False: -3.0}  # m below the sensor: of a road-side unit, of a vehicle
ANCHORS = np.array([(*side, turn) for side in ((2.0, 4.0), (3.0, 12.0)) for turn in (0.0, math.pi / 2, -math.pi / 4)])
SAME = 0.25  # m; no two vehicles stand closer
_TINY = 1e-6  # added to widths and lengths where the targets were made


def voxel_points(indices: Int[np.ndarray, "P 3"], *, rsu: bool) -> Float[np.ndarray, "P 3"]:
    """The middles of occupied voxels in the sensor's frame; m.

    Raises:
        ValueError: an index outside the grid.
    """
    if len(indices) and ((indices < 0).any() or (indices >= (CELLS, CELLS, SLICES)).any()):
        raise ValueError(f"voxel indices must lie in {CELLS} × {CELLS} × {SLICES}")
    lowest = math.floor(FLOOR[rsu] / SLICE) * SLICE
    return (indices + 0.5) * np.array([CELL, CELL, SLICE]) + np.array([-EXTENT, -EXTENT, lowest])


def decode(
    targets: Float[np.ndarray, "S 6"], allocated: Bool[np.ndarray, "256 256 6"], labels: Int[np.ndarray, " S"]
) -> Float[np.ndarray, "L 5"]:
    """The boxes (x, y, length, width, yaw) in the sensor's frame that anchors were given as targets, each once.

    Args:
        targets: box codes of the allocated anchors, in the order of `allocated`.
        allocated: which anchors have a target.
        labels: classes of the allocated anchors; 0 is background.
    """
    i, j, k = np.nonzero(allocated)
    width, length = (ANCHORS[k, side] / np.exp(targets[:, 2 + side]) for side in (0, 1))
    x = width * targets[:, 0] - ((j + 0.5) * CELL - EXTENT)  # of the frame that is not mirrored
    y = (i + 0.5) * CELL - EXTENT - length * targets[:, 1]
    yaw = ANCHORS[k, 2] + np.arctan2(targets[:, 4], targets[:, 5]) - math.pi / 2
    boxes = np.stack([x, y, length - _TINY, width - _TINY, (yaw + math.pi) % (2 * math.pi) - math.pi], axis=1)
    return distinct(boxes[labels > 0])


def distinct(boxes: Float[np.ndarray, "N 5"]) -> Float[np.ndarray, "L 5"]:
    """Each box once: of those whose centres are less than `SAME` m apart the first."""
    if not len(boxes):
        return boxes
    _, first = np.unique(np.round(boxes[:, :2], 3), axis=0, return_index=True)  # makes the square below small
    boxes = boxes[np.sort(first)]
    close = np.hypot(*(boxes[:, None, :2] - boxes[None, :, :2]).T) < SAME
    return boxes[close.argmax(axis=0) == np.arange(len(boxes))]
