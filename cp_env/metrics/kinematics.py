"""Motion of true vehicles: velocities, time to collision, and the deceleration that an obstacle demands.

Scenes hold poses, so velocities are finite differences of them.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from cp_env.types import Scene

DISCS = 5
"""Discs along a vehicle that stand for its outline in the time to collision."""

STANDSTILL = 2.0
"""Distance that is left to an obstacle after braking; m."""

SHORTEST = 0.5
"""Least distance in which braking is computed; m."""

LARGEST = 9.0
"""Deceleration that no car exceeds; m/s²."""

_ALONG = np.linspace(-1.0, 1.0, DISCS)


def velocities(scene: Scene, frame: int) -> Float[np.ndarray, "M 2"]:
    """The velocity of every vehicle of the scene, along the world's axes; m/s.

    A central difference of the poses, one-sided where the scene begins or ends or a vehicle is absent in one of the two
    neighbouring frames. 0 for a vehicle that is there in this frame alone.
    """
    place = scene.pose[:, :, :2]
    here = place[frame]
    before = place[frame - 1] if frame > 0 else np.full_like(here, np.nan)
    after = place[frame + 1] if frame + 1 < scene.n_frames else np.full_like(here, np.nan)
    backward, forward = here - before, after - here
    step = np.where(np.isnan(backward), forward, np.where(np.isnan(forward), backward, (forward + backward) / 2))
    return np.nan_to_num(step, nan=0.0) / scene.dt


def time_to_collision(
    boxes: Float[np.ndarray, "L 5"],
    velocity: Float[np.ndarray, "L 2"],
    ego_box: Float[np.ndarray, " 5"],
    ego_velocity: Float[np.ndarray, " 2"],
) -> Float[np.ndarray, " L"]:
    """Time until each vehicle touches the ego if both keep their velocity and heading; s, inf if they never do.

    A vehicle is `DISCS` discs of its width in a row along its length. So corners are cut by less than half a width, and
    the time of the first contact is a root of a quadratic. A vehicle that touches the ego already has 0.

    Args:
        boxes: vehicles; any frame of reference.
        velocity: of each, m/s.
        ego_box: the ego's, in the same frame.
        ego_velocity: the ego's, m/s.
    """
    if not len(boxes):
        return np.zeros(0)
    (x, y), (ego_x, ego_y) = _discs(boxes), _discs(ego_box[None])
    east, north = x[:, :, None] - ego_x, y[:, :, None] - ego_y  # [L, D, D]
    reach = (boxes[:, 3, None, None] + ego_box[3]) / 2
    drift_x, drift_y = ((velocity - ego_velocity)[:, i, None, None] for i in range(2))
    a = drift_x * drift_x + drift_y * drift_y
    b = east * drift_x + north * drift_y
    c = east * east + north * north - reach * reach
    root = b * b - a * c
    meets = (root >= 0) & (b < 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        time = np.where(meets, (-b - np.sqrt(np.maximum(root, 0.0))) / a, np.inf)
    first: Float[np.ndarray, " L"] = np.where(c <= 0, 0.0, time).reshape(len(boxes), -1).min(axis=1)
    return first


def required_deceleration(closing: Float[np.ndarray, "*n"], gap: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Constant deceleration that takes away the closing speed before the gap is used up; m/s².

    a = max(0, v)² / (2 max(d − 2 m, 0.5 m)), at most 9 m/s².

    Args:
        closing: speed v at which the gap shrinks; m/s.
        gap: d, from bumper to bumper; m. 0 is demanded at an infinite gap.
    """
    speed = np.maximum(closing, 0.0)
    return np.minimum(speed**2 / (2 * np.maximum(gap - STANDSTILL, SHORTEST)), LARGEST)


def _discs(boxes: Float[np.ndarray, "L 5"]) -> tuple[Float[np.ndarray, "L D"], Float[np.ndarray, "L D"]]:
    """x and y of the centres of the discs of each box."""
    half = np.maximum(boxes[:, 2] - boxes[:, 3], 0.0) / 2
    along = _ALONG * half[:, None]
    yaw = boxes[:, 4, None]
    return boxes[:, 0, None] + along * np.cos(yaw), boxes[:, 1, None] + along * np.sin(yaw)
