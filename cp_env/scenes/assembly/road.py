"""The road's height, out of the feet of the vehicles on it: on a hill z is height above the road all the same.

Convention:
    foot    x, y in the world and z of the road under a vehicle; m.
    road    what ordinary kriging with a linear variogram makes of the feet: straight from foot to foot along a line of
            them, level beyond the outermost. Cressie, "Statistics for Spatial Data", 1993, section 3.2.
    Feet that no road can reach from the sensor (`STEEPEST`) stand on another level, such as a bridge, and are left out.
A detector reads z as height above ground, and maps of vehicles that stand at different heights are fused cell by cell.
So sweeps are given with the road at z = 0 wherever the feet say where it is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

STEEPEST = 0.2  # rise over run: no road that vehicles stand on is steeper
STEP = 0.5  # m that a foot may be wrong by
FLAT = 0.2  # m: half a slice of the coarsest grid; where feet differ by less, the road is taken to be level
MOST = 64  # feet that a road is made of, the nearest ones
REACH = 120.0  # m from the sensor
EXACT, DRAWN = 0.1, 5.0  # m: how far a foot is from being believed alone, of simulated boxes and of boxes drawn by hand
_CELL = 4.0  # m, of the raster by which the heights of many points are looked up


@dataclass(frozen=True, eq=False)
class Road:
    """The road round one sensor; `place` and `level` are the sensor's, and heights are from `level`."""

    place: Float[np.ndarray, " 2"]
    level: float  # z of the road under the sensor; m
    _height: Any  # of places round the sensor; None where it is level

    @classmethod
    def through(
        cls,
        feet: Float[np.ndarray, "N 3"],
        place: Float[np.ndarray, " 2"],
        level: float,
        softness: float = EXACT,
        flat: float = FLAT,
    ) -> Road:
        """The road through the feet of one frame.

        Args:
            feet: x, y, z in the world; NaN of vehicles that are absent.
            place: x, y of the sensor in the world; m.
            level: z of the road under it; m.
            softness: the nugget over the variogram's slope, `EXACT` or `DRAWN`; m.
            flat: where feet differ by less, the road is level; m.
        """
        near = feet - (*place, level)
        away = np.hypot(near[:, 0], near[:, 1])
        near = near[(away < REACH) & (np.abs(near[:, 2]) <= STEEPEST * away + STEP)]  # a NaN compares false
        if not len(near) or max(near[:, 2].max(), 0.0) - min(near[:, 2].min(), 0.0) <= flat:
            return cls(place, level, None)
        from scipy.interpolate import RBFInterpolator  # late: a level road needs none

        near = near[np.argsort(np.hypot(near[:, 0], near[:, 1]), kind="stable")[:MOST]]
        return cls(
            place, level, RBFInterpolator(near[:, :2], near[:, 2], kernel="linear", degree=0, smoothing=softness)
        )

    @property
    def is_level(self) -> bool:
        return self._height is None

    def at(self, places: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, " N"]:
        """Height of the road at places given from the sensor's, over the road under the sensor; m."""
        if self._height is None or not len(places):
            return np.zeros(len(places))
        return np.asarray(self._height(places))

    def flatten(self, points: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, "P 3"]:
        """The points with z over the road under each of them, in place of over the road under the sensor.

        Args:
            points: x, y, z from the sensor's place and level, along the world's axes; m.

        Returns:
            They themselves if the road is level. What is farther than `REACH` is given the height of the nearest that
            is not.
        """
        if self._height is None or not len(points):
            return points
        columns = [np.ascontiguousarray(points[:, k]) for k in range(3)]  # numpy is several times as fast on them
        low = [max(float(column.min()), -REACH) for column in columns[:2]]
        high = [min(float(column.max()), REACH) for column in columns[:2]]
        cells = [int(max(end - start, 0.0) / _CELL) + 1 for start, end in zip(low, high, strict=True)]
        x, y = (start + _CELL * np.arange(count + 1) for start, count in zip(low, cells, strict=True))
        nodes = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
        raster = self.at(nodes).astype(np.float32)
        (i, right), (j, up) = (_cells(columns[k], low[k], cells[k]) for k in range(2))
        at = i * np.int32(len(y)) + j
        near, far = (raster.take(at + step) * (1 - up) + raster.take(at + (step + 1)) * up for step in (0, len(y)))
        columns[2] -= near * (1 - right) + far * right
        return np.stack(columns, axis=1)


def _cells(
    column: Float[np.ndarray, " P"], low: float, count: int
) -> tuple[Int[np.ndarray, " P"], Float[np.ndarray, " P"]]:
    """Which cell of a raster each number falls in, and how far into it, from 0 to 1; what is beyond, in its edge."""
    place = ((column - column.dtype.type(low)) * column.dtype.type(1 / _CELL)).clip(0, count)
    cell = np.minimum(place.astype(np.int32), np.int32(count - 1))
    return cell, place - cell.astype(column.dtype)


def levels_under(
    feet: Float[np.ndarray, "T N 3"], places: Float[np.ndarray, "T 2"], softness: float = EXACT
) -> Float[np.ndarray, " T"]:
    """z of the road under a sensor, frame by frame; NaN where there is no foot.

    Args:
        feet: x, y, z in the world; NaN of vehicles that are absent.
        places: x, y of the sensor in the world; m.
        softness: as in `Road.through`.
    """
    levels = np.full(len(feet), np.nan)
    for t, (there, place) in enumerate(zip(feet, places, strict=True)):
        there = there[~np.isnan(there).any(axis=1)]
        if len(there):
            nearest = float(there[np.hypot(*(there[:, :2] - place).T).argmin(), 2])
            levels[t] = nearest + Road.through(there, place, nearest, softness).at(np.zeros((1, 2)))[0]
    return levels


def under_unit(feet: Float[np.ndarray, "T N 3"], place: Float[np.ndarray, " 2"], softness: float = EXACT) -> float:
    """z of the road under a sensor that stands still, the median over the frames; NaN if there is no foot."""
    levels = levels_under(feet, np.broadcast_to(place, (len(feet), 2)), softness)
    known = levels[~np.isnan(levels)]
    return float(np.median(known)) if len(known) else float("nan")
