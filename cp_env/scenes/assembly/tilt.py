"""Vehicles that pitch or roll: their heading, what stands under them, and the returns inside their boxes.

Convention: `world_T_box = [Rz(yaw) · Ry(pitch) · Rx(roll) | centre]`; x points ahead, y to the left, z up, so a
positive pitch lowers the nose and a positive roll lowers the right side. `tilt` is (roll, pitch); rad. Chains stay
three-dimensional to their end, and what lies on the ground is projected there, once.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from cp_env.lidar.returns import BLOCK, CLEARANCE, MARGIN, Raster

LEAST = 0.005  # rad; what leans less stands upright: 1 cm at the end of a car, less than a box may be too tight


def attitude(world_R_box: Float[np.ndarray, "*n 3 3"]) -> Float[np.ndarray, "*n 3"]:
    """Yaw, roll and pitch of a rotation; rad. Yaw is the direction of the x axis seen from above."""
    yaw = np.arctan2(world_R_box[..., 1, 0], world_R_box[..., 0, 0])
    roll = np.arctan2(world_R_box[..., 2, 1], world_R_box[..., 2, 2])
    pitch = np.arcsin(np.clip(-world_R_box[..., 2, 0], -1, 1))
    return np.stack([yaw, roll, pitch], axis=-1)


def foot(boxes: Float[np.ndarray, "*n 7"], tilt: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n"]:
    """Height of the middle of each box's floor; m. Boxes are x, y, z of the middle, length, width, height, yaw."""
    return np.asarray(boxes[..., 2] - boxes[..., 5] / 2 * np.cos(tilt).prod(axis=-1))


def leaning(tilt: Float[np.ndarray, "M 2"]) -> Int[np.ndarray, " R"]:
    """Rows of the boxes that do not stand upright; absent ones (NaN) are none of them."""
    return np.flatnonzero(np.abs(tilt).max(axis=1) > LEAST)


def over_or_under(
    points: Float[np.ndarray, "P 3"],
    box: Float[np.ndarray, " 7"],
    tilt: Float[np.ndarray, " 2"],
    margin: float = MARGIN,
) -> Bool[np.ndarray, " P"]:
    """Which points lie in a leaning box, or over or under it along its own z axis; m, all in one frame."""
    found = np.zeros(len(points), dtype=np.bool_)
    reach = 1.5 * np.linalg.norm(box[3:6]) + margin  # farther off is nothing of a vehicle's
    x, y = (np.abs(points[:, k] - points.dtype.type(box[k])) < reach for k in range(2))
    near = np.flatnonzero(x & y)
    along, across, _ = ((points[near] - box[:3]) @ world_R_box(box[6], *tilt)).T
    found[near] = (np.abs(along) <= box[3] / 2 + margin) & (np.abs(across) <= box[4] / 2 + margin)
    return found


def count_returns(
    points: Float[np.ndarray, "P 3"],
    boxes: Float[np.ndarray, "R 7"],
    tilt: Float[np.ndarray, "R 2"],
    margin: float = MARGIN,
) -> Int[np.ndarray, " R"]:
    """Points inside each leaning box, counted as `cp_env.lidar.returns.count_returns` counts in upright ones.

    Args:
        points: x, y, z; m.
        boxes: x, y, z of the middle, length, width, height, yaw, in the frame of the points; m, rad.
        tilt: roll and pitch of each box; rad.
        margin: m, by which a box may be too tight.
    """
    hits = np.zeros(len(boxes), dtype=np.int64)
    if not len(boxes) or not len(points):
        return hits
    turn = world_R_box(boxes[:, 6], *tilt.T)
    place, half = boxes[:, :3].T.astype(points.dtype), boxes[:, 3:6].T / 2
    columns = np.ascontiguousarray(points.T)
    raster = Raster.of(_upright_hull(boxes, tilt), columns, margin)
    for begin in range(0, len(points), BLOCK):
        block = columns[:, begin : begin + BLOCK]
        point, box = raster.pairs(block)
        offset = [block[k].take(point) - place[k].take(box) for k in range(3)]
        along, across, up = (sum(offset[k] * turn[:, k, axis].take(box) for k in range(3)) for axis in range(3))
        length, width, height = (half[k].take(box) for k in range(3))
        inside = (up <= height + margin) & (up >= CLEARANCE - height)
        inside &= (np.abs(along) <= length + margin) & (np.abs(across) <= width + margin)
        hits += np.bincount(box[inside], minlength=len(boxes))
    return hits


def _upright_hull(boxes: Float[np.ndarray, "R 7"], tilt: Float[np.ndarray, "R 2"]) -> Float[np.ndarray, "R 7"]:
    """Upright boxes of the same headings that hold the leaning ones, and what lies close under them."""
    lean = np.abs(world_R_box(np.zeros(len(boxes)), *tilt.T))
    size = (lean @ boxes[:, 3:6, None])[..., 0] + (0, 0, 2 * CLEARANCE)
    return np.concatenate([boxes[:, :3], size, boxes[:, 6:]], axis=1)


def level(
    flat: Float[np.ndarray, "N 2"], world_R_sensor: Float[np.ndarray, "3 3"], height: float
) -> Float[np.ndarray, "N 2"]:
    """Where level things are in the world that a leaning sensor's frame gives by x and y alone.

    Their z in that frame is what puts them at `height` above the sensor, measured along the world's z axis.

    Args:
        flat: x, y in the sensor's frame; m.
        world_R_sensor: from the sensor's axes to the world's.
        height: above the sensor; m.

    Returns:
        x, y from the sensor along the world's axes; m.
    """
    z = (height - flat @ world_R_sensor[2, :2]) / world_R_sensor[2, 2]
    return np.asarray(flat @ world_R_sensor[:2, :2].T + z[:, None] * world_R_sensor[:2, 2])


def world_R_box(
    yaw: Float[np.ndarray, "*n"] | float, roll: Float[np.ndarray, "*n"] | float, pitch: Float[np.ndarray, "*n"] | float
) -> Float[np.ndarray, "*n 3 3"]:
    """The rotations of bodies with those headings, rolls and pitches; rad."""
    angles = np.stack(np.broadcast_arrays(yaw, roll, pitch))
    (cy, cr, cp), (sy, sr, sp) = np.cos(angles), np.sin(angles)
    rows = (
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
