"""A LiDAR by the textbook: one ray, one box, three slabs. Slow twin of `cp_env.lidar.raycast`."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from cp_env.lidar.raycast import GROUND, NOTHING, Mount, Prisms

Vector = tuple[float, float, float]


def enter_box(origin: Vector, ray: Vector, box: np.ndarray) -> float:
    """How far along the unit vector `ray` it enters (x, y, yaw, length, width, height) on the ground; inf if it misses.

    The slab method (Kay and Kajiya 1986) in the box's own axes.
    """
    x, y, yaw, length, width, height = map(float, box)
    cos, sin = math.cos(yaw), math.sin(yaw)
    dx, dy = origin[0] - x, origin[1] - y
    start = (cos * dx + sin * dy, -sin * dx + cos * dy, origin[2])
    step = (cos * ray[0] + sin * ray[1], -sin * ray[0] + cos * ray[1], ray[2])
    bounds = ((-length / 2, length / 2), (-width / 2, width / 2), (0.0, height))
    first, last = 0.0, math.inf
    for at, by, (low, high) in zip(start, step, bounds, strict=True):
        if by == 0:
            if not low <= at <= high:
                return math.inf
            continue
        one, other = (low - at) / by, (high - at) / by
        first, last = max(first, min(one, other)), min(last, max(one, other))
    return first if first < last else math.inf


def contains(box: np.ndarray, point: Vector) -> bool:
    x, y, yaw, length, width, height = map(float, box)
    dx, dy = point[0] - x, point[1] - y
    along, across = math.cos(yaw) * dx + math.sin(yaw) * dy, -math.sin(yaw) * dx + math.cos(yaw) * dy
    return abs(along) <= length / 2 and abs(across) <= width / 2 and point[2] <= height


def cast(world: Prisms, mount: Mount, azimuth: float, elevation: float) -> tuple[float, int]:
    """Range along one ray (m, inf if nothing) and the owner of what it meets; azimuth from the heading; rad."""
    origin = (mount.x, mount.y, mount.z)
    level = math.cos(elevation)
    ray = (level * math.cos(mount.yaw + azimuth), level * math.sin(mount.yaw + azimuth), math.sin(elevation))
    best, owner = (mount.z / -ray[2], GROUND) if ray[2] < 0 else (math.inf, NOTHING)
    for box, whose in zip(world.box, world.owner.tolist(), strict=True):
        if whose == mount.carrier or contains(box, origin):
            continue
        met = enter_box(origin, ray, box)
        if met < best:
            best, owner = met, whose
    return best, owner


def revolve(world: Prisms, mount: Mount, elevations: Iterable[float], azimuths: int) -> tuple[np.ndarray, np.ndarray]:
    """Ranges and owners [azimuths, beams] of a whole revolution; elevations in degrees."""
    rays = [
        [cast(world, mount, 2 * math.pi * k / azimuths, math.radians(e)) for e in elevations] for k in range(azimuths)
    ]
    return np.array([[r for r, _ in row] for row in rays]), np.array([[o for _, o in row] for row in rays])
