"""Whether a vehicle's returns lie in its box: what is amiss where axes are mirrored, turned or shifted.

A vehicle's returns, as far as anybody can tell: what the source says (`Sweep.hits`), or else the returns off the road
that lie within `ROUND` of its box, in no other vehicle's and in no obstacle that the scene knows. Where many of them
lie outside, the box is missed. All is seen from above: heights are what data sets leave out or guess.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from cp_env.types import Scene, Sweep

GROWN = 0.2  # m, by which boxes are grown: annotations and voxels are not exact
ROUND = 1.0  # m round a box: returns from there count as its vehicle's
ROAD = 0.3  # m above ground; lower returns may be road
LEAST = 5  # returns that a vehicle is judged by
MOST = 0.6  # of its returns lie in the box of a vehicle that is not missed
REACH = 30.0  # m from the sensor


@dataclass(frozen=True, eq=False)
class Fit:
    """The vehicles that one sweep is said or seen to meet, within `REACH`; the carrier is none of them."""

    rows: Int[np.ndarray, " R"]  # among the scene's vehicles
    inside: Int[np.ndarray, " R"]  # returns in the grown box
    returns: Int[np.ndarray, " R"]  # of the vehicle; at least `LEAST`

    @property
    def missed(self) -> Bool[np.ndarray, " R"]:
        """Whether less than `MOST` of a vehicle's returns lie in its box."""
        return self.inside < MOST * self.returns


def fit(scene: Scene, frame: int, agent: int, sweep: Sweep) -> Fit:
    """How the returns of one sweep fit the boxes of its frame."""
    place = scene.pose[frame, :, :2] - sweep.origin[:2]
    away = np.linalg.norm(place, axis=1)  # a NaN compares false
    around = np.flatnonzero(away < REACH + 2 * ROUND + scene.size[:, :2].max(initial=0))
    solid = sweep.points[sweep.points[:, 2] > ROAD].astype(np.float64)
    boxes = np.column_stack([place[around], scene.pose[frame, around, 2], scene.size[around]])
    near = [_near(solid, box) for box in boxes]  # points of each box and its surroundings, and which lie in it
    held = np.zeros(len(solid), dtype=np.int64)
    for points, inside in near:
        held[points[inside]] += 1
    for wall in _walls(scene, sweep):
        points, inside = _near(solid, wall)
        held[points[inside]] += 1
    own = np.array([inside.sum() for _, inside in near], dtype=np.int64)
    returns = own.copy()
    for k, (points, inside) in enumerate(near):
        stray = points[~inside]
        elsewhere = held[stray]
        for twin in _same_place(boxes, k):
            elsewhere -= np.isin(stray, near[twin][0][near[twin][1]])
        returns[k] += (elsewhere == 0).sum()
    if sweep.hits is not None:
        returns = np.maximum(returns, sweep.hits[around])
    judged = (away[around] < REACH) & (returns >= LEAST)
    if agent < scene.n_connected:
        judged &= around != scene.connected[agent]
    return Fit(around[judged], own[judged], returns[judged])


def share_inside(fits: Sequence[Fit]) -> tuple[int, int]:
    """How many vehicles are not missed, and of how many; each counts once for every sweep that meets it."""
    missed = sum(int(one.missed.sum()) for one in fits)
    total = sum(len(one.rows) for one in fits)
    return total - missed, total


def _same_place(boxes: Float[np.ndarray, "N 6"], k: int) -> list[int]:
    """Boxes that overlap box `k` as no other vehicle's can: their middles lie in it."""
    x, y = (boxes[:, :2] - boxes[k, :2]).T
    cos, sin = np.cos(boxes[k, 2]), np.sin(boxes[k, 2])
    inside = (np.abs(cos * x + sin * y) < boxes[k, 3] / 2) & (np.abs(cos * y - sin * x) < boxes[k, 4] / 2)
    inside[k] = False
    return np.flatnonzero(inside).tolist()


def _walls(scene: Scene, sweep: Sweep) -> Float[np.ndarray, "B 6"]:
    """The scene's obstacles that a sweep's vehicles may stand beside: x, y from the sensor, yaw, sizes; m, rad."""
    walls = scene.obstacles - np.append(sweep.origin[:2], np.zeros(4))
    reach = REACH + 2 * ROUND + np.hypot(walls[:, 3], walls[:, 4])
    return np.asarray(walls[np.hypot(walls[:, 0], walls[:, 1]) < reach])


def _near(
    points: Float[np.ndarray, "P 3"], box: Float[np.ndarray, " 6"]
) -> tuple[Int[np.ndarray, " Q"], Bool[np.ndarray, " Q"]]:
    """Numbers of the points within `ROUND` of a box (x, y, yaw, length, width, height), and which lie in it, grown."""
    offset = points[:, :2] - box[:2]
    rough = np.flatnonzero((np.abs(offset) < np.hypot(*box[3:5]) / 2 + 2 * ROUND).all(axis=1))
    rough = rough[points[rough, 2] <= box[5] + ROUND]
    cos, sin = np.cos(box[2]), np.sin(box[2])
    along, across = np.abs(offset[rough] @ np.array([[cos, -sin], [sin, cos]])).T
    beyond = np.maximum(along - box[3] / 2, across - box[4] / 2)
    return rough[beyond <= ROUND], beyond[beyond <= ROUND] <= GROWN
