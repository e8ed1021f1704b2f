"""Ground truth: every vehicle in the ego's range, seen or hidden, under the same two protocols as average precision.

The protocols differ in how far the range reaches and in whether the ego counts:

    strict        (the default) centres inside the map of ±extent; the ego itself is left out.
    coperception  as its preprocessing chooses the cars that its AP counts: centres up to 0.5 m beyond the map, that is
                  32.5 m (the limit itself counts), and the ego's own car is one of them. Their map has the ego's axes
                  and begins at its sensor: `axes="ego"` gives range and boxes in that frame, from the middle of the
                  ego's box, where sweeps begin here. Only "vehicle.car" and "vehicle.emergency.police" count there:
                  choose them as the source's categories.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from cp_env.geometry.planar import compose, grid_origin, invert
from cp_env.types import Scene

BEYOND = 0.5  # m outside the map that coperception's truth reaches


def rows_in_range(
    scene: Scene, frame: int, ego: int, extent: float, protocol: str = "strict", axes: str = "grid"
) -> Int[np.ndarray, " L"]:
    """The scene's vehicles that count as truth of vehicle row `ego`.

    Args:
        scene: the scene.
        frame: number of the frame.
        ego: row of the vehicle whose range it is.
        extent: reach of the map to each side; m.
        protocol: "strict" or "coperception", see above.
        axes: "grid", the range lies along the world's axes round the ego's grid origin; "ego", along the ego's own axes
            round its place.

    Raises:
        ValueError: an unknown protocol or unknown axes.
    """
    return _in_range(_placed(scene, frame, ego, axes), ego, extent, protocol)


def truth_boxes(
    scene: Scene, frame: int, ego: int, extent: float, protocol: str = "strict", axes: str = "grid"
) -> Float[np.ndarray, "L 5"]:
    """Their boxes (x, y, length, width, yaw) in the ego's grid frame, or with `axes="ego"` in its own; m, rad."""
    pose = _placed(scene, frame, ego, axes)
    rows = _in_range(pose, ego, extent, protocol)
    return np.concatenate([pose[rows, :2], scene.size[rows, :2], pose[rows, 2:]], axis=1).astype(np.float32)


def _placed(scene: Scene, frame: int, ego: int, axes: str) -> Float[np.ndarray, "M 3"]:
    """x, y, yaw of all vehicles in the frame of the truth; m, rad."""
    pose = scene.pose[frame]
    if axes == "ego":
        return compose(np.broadcast_to(invert(pose[ego]), pose.shape), pose)
    if axes != "grid":
        raise ValueError(f"axes of the truth must be 'grid' or 'ego', not {axes!r}")
    return np.concatenate([pose[:, :2] - grid_origin(pose[ego, :2]), pose[:, 2:]], axis=1)


def _in_range(pose: Float[np.ndarray, "M 3"], ego: int, extent: float, protocol: str) -> Int[np.ndarray, " L"]:
    offset = np.abs(pose[:, :2])
    if protocol == "coperception":
        return np.flatnonzero((offset <= extent + BEYOND).all(axis=1))  # a NaN (absent) compares false
    if protocol != "strict":
        raise ValueError(f"unknown protocol {protocol!r} of the truth: choose one of strict, coperception")
    inside = (offset < extent).all(axis=1)
    inside[ego] = False
    return np.flatnonzero(inside)
