"""Ground truth: every vehicle in the ego's range, seen or hidden, the ego itself left out."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from cp_env.geometry.planar import grid_origin
from cp_env.types import Scene


def rows_in_range(scene: Scene, frame: int, ego: int, extent: float) -> Int[np.ndarray, " L"]:
    """The scene's vehicles whose centre lies within ±extent m (x and y) of the grid origin of vehicle row `ego`."""
    offset = np.abs(scene.pose[frame, :, :2] - grid_origin(scene.pose[frame, ego, :2]))
    inside = (offset < extent).all(axis=1)  # a NaN (absent) compares false
    inside[ego] = False
    return np.flatnonzero(inside)


def truth_boxes(scene: Scene, frame: int, ego: int, extent: float) -> Float[np.ndarray, "L 5"]:
    """Their boxes (x, y, length, width, yaw) in the ego's grid frame; m, rad."""
    rows = rows_in_range(scene, frame, ego, extent)
    centre = scene.pose[frame, rows, :2] - grid_origin(scene.pose[frame, ego, :2])
    return np.concatenate([centre, scene.size[rows, :2], scene.pose[frame, rows, 2:]], axis=1).astype(np.float32)
