"""The axes of the files and ours.

Convention:
    CARLA   left-handed: x forward (east), y right (south), z up; degrees; yaw turns from x to y, that is clockwise seen
            from above; a positive pitch lifts the nose, a positive roll lowers the right side. A pose is
            (x, y, z, roll, yaw, pitch).
    real    recordings of real vehicles in OPV2V's folders: right-handed, y to the left. Their poses are 4 × 4 matrices,
            or six numbers that make a matrix by CARLA's formula.
    ours    right-handed: x east, y north, z up; radians, counter-clockwise.
    CARLA's world and ours share x and z; y is mirrored. So are the frames of the sensors and of the vehicles. A real
    world is taken as it is.

    ```
       CARLA, from above            ours, from above
       z points at you              z points at you

       ●────▶ x                     y
       │ ╲ yaw                      ▲  ↗ yaw
       │  ↘                         │ ╱
       ▼                            │╱
       y                            ●────▶ x
    ```
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

_MIRROR = np.array([1.0, -1.0, 1.0])


def carla_motion(pose: Float[np.ndarray, "*n 6"]) -> Float[np.ndarray, "*n 3 4"]:
    """carla_T_body, `[R | t]`, of a pose (x, y, z, roll, yaw, pitch): from the body to CARLA's world; m, degrees."""
    angle = np.deg2rad(pose[..., 3:])
    (cr, cy, cp), (sr, sy, sp) = np.moveaxis(np.cos(angle), -1, 0), np.moveaxis(np.sin(angle), -1, 0)
    rows = (
        (cp * cy, cy * sp * sr - sy * cr, -cy * sp * cr - sy * sr, pose[..., 0]),
        (sy * cp, sy * sp * sr + cy * cr, -sy * sp * cr + cy * sr, pose[..., 1]),
        (sp, -cp * sr, cp * cr, pose[..., 2]),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def from_carla(pose: Float[np.ndarray, "*n 6"]) -> Float[np.ndarray, "*n 3 4"]:
    """world_T_body, `[R | t]`, in our axes: from the body, its y to the left, to our world; m."""
    return _MIRROR[:, None] * carla_motion(pose) * np.append(_MIRROR, 1.0)


def planar(world_T_body: Float[np.ndarray, "*n 3 4"]) -> Float[np.ndarray, "*n 3"]:
    """x, y and heading of a body: where its x axis points on the ground; m, m, rad."""
    yaw = np.arctan2(world_T_body[..., 1, 0], world_T_body[..., 0, 0])
    return np.stack([world_T_body[..., 0, 3], world_T_body[..., 1, 3], yaw], axis=-1)


def mirrored(points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """Points of a body from CARLA's axes to ours, or back."""
    return points * _MIRROR.astype(points.dtype)


def to_carla(x: float, y: float, z: float, yaw: float) -> list[float]:
    """CARLA's pose (x, y, z, roll, yaw, pitch), m and degrees, of a body upright at our x, y, z, yaw; m and rad."""
    return [float(x), float(-y), float(z), 0.0, float(-np.rad2deg(yaw)), 0.0]
