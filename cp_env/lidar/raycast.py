"""Rays from spinning sensors against vertical prisms on flat ground; all sensors of many worlds at once.

A ray is traced in two steps: where its azimuth's vertical plane enters and leaves a footprint (in 2D, once for all
beams), then what each beam meets between the two: the side, the top, or nothing. The nearest thing wins, the ground
included. Azimuths that cannot touch a footprint are never tried, so the work grows with what is hit, not with
sensors x rays x prisms.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

GROUND, NOTHING = 1 << 23, (1 << 23) + 1  # owners of rays that meet no prism; exact as 32-bit floats


@dataclass(frozen=True, eq=False)
class Prisms:
    """What reflects in one world: oriented boxes standing on the ground."""

    box: Float[np.ndarray, "B 6"]  # x, y, yaw, length, width, height; world frame, m and rad
    owner: Int[np.ndarray, " B"]  # a number for what the prism is part of, below `GROUND`


@dataclass(frozen=True)
class Mount:
    """A sensor where it stands."""

    world: int
    x: float  # world frame; m
    y: float
    z: float
    yaw: float = 0.0  # rad; azimuth 0 points this way
    carrier: int = -1  # owner of the prisms it does not see


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Every (sensor, prism) that could meet, as the sensor sees it, in sensor order."""

    sensor: Int[np.ndarray, " K"]
    owner: Int[np.ndarray, " K"]
    centre: Float[np.ndarray, "K 2"]  # of the prism, from the sensor; m
    foot: Float[np.ndarray, "K 2"]  # of the sensor, along and across the prism from its centre; m
    half: Float[np.ndarray, "K 2"]  # half length, half width; m
    axis: Float[np.ndarray, "K 2"]  # cos and sin of the prism's yaw
    above: Float[np.ndarray, " K"]  # of the prism's top over the sensor; m

    @property
    def over(self) -> Bool[np.ndarray, " K"]:
        """Whether the sensor stands within the footprint; it is then above the top."""
        return (np.abs(self.foot) <= self.half).all(1)


def trace(
    worlds: Sequence[Prisms],
    mounts: Sequence[Mount],
    slope: Float[Tensor, " Be"],
    azimuths: int,
    max_distance: float,
) -> tuple[Float[Tensor, "S Az Be"], Int[Tensor, "S Az Be"]]:
    """What every ray meets first: its horizontal distance (m, infinite if nothing) and its owner.

    slope: metres up for each horizontal metre, one a beam, none of them 0; the result lies on its device.
    max_distance: prisms wholly beyond it (m, horizontally) may be left out.
    A prism that contains the sensor is left out. Mounts of one world must be consecutive to be fast.
    """
    device = slope.device
    pairs = _pairs(worlds, mounts, max_distance)
    which, column, enter, leave = _cross(pairs, directions(mounts, azimuths), device)
    above = torch.from_numpy(pairs.above).to(device).float()[which]
    free = _in_the_open(column, enter, above, slope, len(mounts) * azimuths)
    which, column, enter, leave, above = (a[free] for a in (which, column, enter, leave, above))
    owner = torch.from_numpy(pairs.owner).to(device).float()[which]
    height = torch.tensor([mount.z for mount in mounts], device=device)
    ground = torch.where(slope < 0, -height[:, None] / slope, math.inf).repeat_interleave(azimuths, 0)
    distance = _meet(enter[:, None], leave[:, None], above[:, None], slope)
    target = column[:, None].expand_as(distance)
    nearest = ground.scatter_reduce(0, target, distance, "amin")
    first = (distance == nearest.index_select(0, column)) & (distance < math.inf)
    claim = torch.where(first, owner[:, None], NOTHING)
    unclaimed = torch.where(nearest < math.inf, float(GROUND), float(NOTHING))
    whose = unclaimed.scatter_reduce(0, target, claim, "amin")  # of two at one distance, the lower number
    shape = (len(mounts), azimuths, len(slope))
    return nearest.view(shape), whose.long().view(shape)


def directions(mounts: Sequence[Mount], azimuths: int) -> Float[np.ndarray, "S Az 2"]:
    """Horizontal unit vectors of the rays, in the world's axes: from the sensor's heading, counter-clockwise."""
    angle = 2 * np.pi * np.arange(azimuths) / azimuths
    x, y = np.cos(angle), np.sin(angle)
    cos = np.array([math.cos(mount.yaw) for mount in mounts])[:, None]
    sin = np.array([math.sin(mount.yaw) for mount in mounts])[:, None]
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


def _pairs(worlds: Sequence[Prisms], mounts: Sequence[Mount], max_distance: float) -> _Pairs:
    world, found = -1, []
    for sensor, mount in enumerate(mounts):
        if mount.world != world:
            world = mount.world
            box, owner = worlds[world].box, worlds[world].owner
            axis = np.stack([np.cos(box[:, 2]), np.sin(box[:, 2])], axis=1)
            half = 0.5 * box[:, 3:5]
            radius = np.sqrt((half**2).sum(1))
        centre = box[:, :2] - (mount.x, mount.y)
        foot = _into(-centre, axis)
        above = box[:, 5] - mount.z
        contains = (np.abs(foot) <= half).all(1) & (above >= 0)
        near = np.sqrt((centre**2).sum(1)) - radius <= max_distance
        keep = near & (owner != mount.carrier) & ~contains
        place = np.full(int(keep.sum()), sensor)
        found.append((place, owner[keep], centre[keep], foot[keep], half[keep], axis[keep], above[keep]))
    return _Pairs(*(np.concatenate(part) for part in zip(*found, strict=True)))


def _into(point: Float[np.ndarray, "K 2"], axis: Float[np.ndarray, "K 2"]) -> Float[np.ndarray, "K 2"]:
    """Each point along and across an axis, which is given by its cos and sin."""
    along = axis[:, 0] * point[:, 0] + axis[:, 1] * point[:, 1]
    return np.stack([along, axis[:, 0] * point[:, 1] - axis[:, 1] * point[:, 0]], axis=1)


def _span(pairs: _Pairs, rays: Float[np.ndarray, "S Az 2"]) -> tuple[Int[np.ndarray, " K"], Int[np.ndarray, " K"]]:
    """The first azimuth (may be negative: they go round) whose ray could cross each footprint, and how many do.

    Generous by a hair on both sides: an exact test follows.
    """
    azimuths = rays.shape[1]
    c, s = pairs.axis[:, :1], pairs.axis[:, 1:]
    along = pairs.half[:, :1] * np.array([1, -1, -1, 1])
    across = pairs.half[:, 1:] * np.array([1, 1, -1, -1])
    corner = np.arctan2(pairs.centre[:, 1:] + s * along + c * across, pairs.centre[:, :1] + c * along - s * across)
    bearing = np.arctan2(pairs.centre[:, 1], pairs.centre[:, 0])
    spread = np.remainder(corner - bearing[:, None] + np.pi, 2 * np.pi) - np.pi
    heading = np.arctan2(rays[:, 0, 1], rays[:, 0, 0])[pairs.sensor]
    turn = azimuths / (2 * np.pi)
    first = np.ceil((bearing - heading + spread.min(1)) * turn - 1e-6).astype(np.int64)
    last = np.floor((bearing - heading + spread.max(1)) * turn + 1e-6).astype(np.int64)
    over = pairs.over
    return np.where(over, 0, first), np.where(over, azimuths, np.minimum(last - first + 1, azimuths))


def _cross(
    pairs: _Pairs, rays: Float[np.ndarray, "S Az 2"], device: torch.device
) -> tuple[Int[Tensor, " R"], Int[Tensor, " R"], Float[Tensor, " R"], Float[Tensor, " R"]]:
    """Where rays cross footprints: the pair, the column (sensor * azimuths + azimuth), and at what horizontal
    distances (m) the ray enters and leaves."""
    azimuths = rays.shape[1]
    first, count = _span(pairs, rays)
    pair = np.repeat(np.arange(len(count)), count)
    azimuth = (np.arange(len(pair)) - (np.cumsum(count) - count - first)[pair]) % azimuths
    which = torch.from_numpy(pair).to(device)
    column = torch.from_numpy(pairs.sensor[pair] * azimuths + azimuth).to(device)
    x, y = torch.from_numpy(rays.reshape(-1, 2)).to(device)[column].unbind(1)
    foot, half, axis = (torch.from_numpy(a).to(device)[which] for a in (pairs.foot, pairs.half, pairs.axis))
    heading = torch.stack([axis[:, 0] * x + axis[:, 1] * y, axis[:, 0] * y - axis[:, 1] * x], dim=1)
    inverse = 1.0 / torch.where(heading.abs() < 1e-12, 1e-12, heading)
    one, other = (-half - foot) * inverse, (half - foot) * inverse
    enter = torch.minimum(one, other).amax(1).clamp_min(0.0)
    leave = torch.maximum(one, other).amin(1)
    hit = (enter < leave).nonzero()[:, 0]
    return which[hit], column[hit], enter[hit].float(), leave[hit].float()


def _in_the_open(
    column: Int[Tensor, " R"],
    enter: Float[Tensor, " R"],
    above: Float[Tensor, " R"],
    slope: Float[Tensor, " Be"],
    columns: int,
) -> Int[Tensor, " Q"]:
    """The crossings that lie before the first in their column that stops even the highest beam.

    No beam meets anything in the others. For speed only: in a street most of the town is behind the first house.
    """
    wall = torch.full((columns,), math.inf, device=enter.device)
    stops = torch.where(above >= slope.max() * enter, enter, math.inf)
    wall.scatter_reduce_(0, column, stops, "amin")
    return (enter <= wall[column]).nonzero()[:, 0]


def _meet(
    enter: Float[Tensor, "R 1"], leave: Float[Tensor, "R 1"], above: Float[Tensor, "R 1"], slope: Float[Tensor, " Be"]
) -> Float[Tensor, "R Be"]:
    """The horizontal distance at which each beam meets a prism whose top is `above` m over the sensor; else infinite.

    A beam is as high as the top at distance above / slope. One that descends passes over the prism before that and
    strikes it beyond; one that climbs strikes it before that and passes over beyond.
    """
    level = above / slope
    distance = torch.where(slope < 0, torch.maximum(enter, level), enter)
    meets = torch.where(slope < 0, distance <= leave, enter <= level)
    return torch.where(meets, distance, math.inf)
