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
    offset = _discs(boxes)[:, :, None] - _discs(ego_box[None])[:, None]  # [L, D, D, 2]
    reach = (boxes[:, 3, None, None] + ego_box[3]) / 2
    drift = (velocity - ego_velocity)[:, None, None]
    a = (drift**2).sum(-1)
    b = (offset * drift).sum(-1)
    c = (offset**2).sum(-1) - reach**2
    root = b**2 - a * c
    meets = (root >= 0) & (b < 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        time = np.where(meets, (-b - np.sqrt(np.maximum(root, 0.0))) / a, np.inf)
    first: Float[np.ndarray, " L"] = np.where(c <= 0, 0.0, time).min(axis=(1, 2), initial=np.inf)
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


def _discs(boxes: Float[np.ndarray, "L 5"]) -> Float[np.ndarray, "L D 2"]:
    """Centres of the discs of each box."""
    half = np.maximum(boxes[:, 2] - boxes[:, 3], 0.0) / 2
    along = np.linspace(-1.0, 1.0, DISCS) * half[:, None]
    heading = np.stack([np.cos(boxes[:, 4]), np.sin(boxes[:, 4])], axis=-1)
    return boxes[:, None, :2] + along[..., None] * heading[:, None]
