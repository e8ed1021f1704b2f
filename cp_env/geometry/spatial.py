"""Rigid motion in space, as data sets store it.

Convention: `a_T_b` is 3 × 4, `[R | t]`; it takes points of frame b to points of frame a. Quaternions are (w, x, y, z).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def rotation(quaternion: Float[np.ndarray, "*n 4"]) -> Float[np.ndarray, "*n 3 3"]:
    """The rotation matrix of a unit quaternion."""
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def upright(yaw: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n 4"]:
    """The quaternion of a turn by `yaw` rad about z."""
    zero = np.zeros_like(yaw)
    return np.stack([np.cos(yaw / 2), zero, zero, np.sin(yaw / 2)], axis=-1)


def heading(a_T_b: Float[np.ndarray, "*n 3 _"]) -> Float[np.ndarray, "*n"]:
    """Yaw of the x axis of b as seen in the plane of a; rad."""
    return np.asarray(np.arctan2(a_T_b[..., 1, 0], a_T_b[..., 0, 0]))


def motion(
    quaternion: Float[np.ndarray, "*n 4"], translation: Float[np.ndarray, "*n 3"]
) -> Float[np.ndarray, "*n 3 4"]:
    """`a_T_b` of a frame b that is turned by `quaternion` and stands at `translation` in a."""
    return np.concatenate([rotation(quaternion), translation[..., None]], axis=-1)


def chain(a_T_b: Float[np.ndarray, "*n 3 4"], b_T_c: Float[np.ndarray, "*n 3 4"]) -> Float[np.ndarray, "*n 3 4"]:
    """`a_T_c`."""
    turned = a_T_b[..., :3] @ b_T_c
    turned[..., 3] += a_T_b[..., 3]
    return turned


def inverse(a_T_b: Float[np.ndarray, "*n 3 4"]) -> Float[np.ndarray, "*n 3 4"]:
    """`b_T_a`."""
    back = np.swapaxes(a_T_b[..., :3], -1, -2)
    return np.concatenate([back, -back @ a_T_b[..., 3:]], axis=-1)
