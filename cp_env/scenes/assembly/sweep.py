"""A sensor's points put in place: through the whole chain in three dimensions, projected once, heights over the road.

Returns are counted, and the carrier's own left out, before a hill is made level: along the axes of the boxes as they
stand, leaning or not, each at its own height.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from cp_env.lidar.returns import MARGIN, to_world_axes
from cp_env.lidar.returns import count_returns as count_upright
from cp_env.scenes.assembly.road import Road
from cp_env.scenes.assembly.tilt import count_returns as count_leaning
from cp_env.scenes.assembly.tilt import leaning, over_or_under
from cp_env.types import Sweep


def placed_sweep(
    points: Float[np.ndarray, "P 3"],
    world_T_sensor: Float[np.ndarray, "3 4"],
    road: Road,
    boxes: Float[np.ndarray, "M 7"],
    tilt: Float[np.ndarray, "M 2"],
    own: int | None,
    margin: float = MARGIN,
) -> Sweep:
    """One sensor's sweep as `cp_env.types.Sweep` has it.

    Args:
        points: as the sensor has them; m.
        world_T_sensor: from the sensor's axes to the world.
        road: round the sensor; its place is that from which points are given.
        boxes: x, y, z of the middle, length, width, height, yaw of all vehicles in the world; m, rad, NaN if absent.
        tilt: roll and pitch of each, as in `tilt`; rad.
        own: the vehicle that carries the sensor, whose returns are left out; None under a road-side unit.
        margin: m, by which a box may be too tight.
    """
    shift = world_T_sensor[:, 3] - (*road.place, road.level)
    near = boxes - (*road.place, road.level, 0, 0, 0, 0)
    rows = leaning(tilt)
    upright = near.copy()
    upright[rows[rows != own]] = np.nan  # they are counted below
    points, hits = to_world_axes(points, world_T_sensor[:, :3], shift, upright, own, margin)
    if own is not None and own in rows:
        keep = ~over_or_under(points, near[own], tilt[own], margin)
        if not keep.all():
            points = points[keep]
            hits = count_upright(points, upright, margin)
    if len(rows):
        hits[rows] = count_leaning(points, near[rows], tilt[rows], margin)
    return Sweep(road.flatten(points), np.array([*road.place, shift[2]]), hits)
