"""Rigid motion in the plane.

Convention: `a_T_b = (x, y, yaw)` is the pose of frame b in frame a; it takes points of b to points of a. Angles are
counter-clockwise radians. A chain is checked by eye: `a_T_c = compose(a_T_b, b_T_c)`.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def compose(a_T_b: Float[np.ndarray, "*n 3"], b_T_c: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """The pose of c in a."""
    cos, sin = np.cos(a_T_b[..., 2]), np.sin(a_T_b[..., 2])
    x, y = b_T_c[..., 0], b_T_c[..., 1]
    return np.stack(
        [a_T_b[..., 0] + cos * x - sin * y, a_T_b[..., 1] + sin * x + cos * y, a_T_b[..., 2] + b_T_c[..., 2]], axis=-1
    )


def invert(a_T_b: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """The pose of a in b."""
    cos, sin = np.cos(a_T_b[..., 2]), np.sin(a_T_b[..., 2])
    x, y = a_T_b[..., 0], a_T_b[..., 1]
    return np.stack([-cos * x - sin * y, sin * x - cos * y, -a_T_b[..., 2]], axis=-1)


LATTICE = 2.0
"""Side of a shared map's cell, m: grid frames begin at whole multiples of it in the world."""


def grid_origin(place: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
    """Where in the world the grid frame of whoever stands at `place` begins: the lattice point next to it; m.

    All maps share one lattice, so moving one into another's frame shifts it by whole cells and blurs nothing. Our
    choice: the paper leaves the frames open, and vehicles that share maps share their poses anyway.
    """
    return np.round(np.asarray(place, dtype=np.float64) / LATTICE) * LATTICE


def corners(boxes: Float[np.ndarray, "*n 5"]) -> Float[np.ndarray, "*n 4 2"]:
    """The corners of (x, y, length, width, yaw) boxes, counter-clockwise from front left."""
    unit = np.array([[0.5, 0.5], [-0.5, 0.5], [-0.5, -0.5], [0.5, -0.5]])
    local = unit * boxes[..., None, 2:4]
    cos, sin = np.cos(boxes[..., 4, None]), np.sin(boxes[..., 4, None])
    x = boxes[..., 0, None] + cos * local[..., 0] - sin * local[..., 1]
    y = boxes[..., 1, None] + sin * local[..., 0] + cos * local[..., 1]
    return np.stack([x, y], axis=-1)
