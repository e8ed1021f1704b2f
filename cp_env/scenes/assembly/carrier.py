"""Tracks of listed objects, and which of them carries a sensor where the files do not say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from jaxtyping import Float

from cp_env.geometry.planar import compose, invert
from cp_env.scenes.assembly.tilt import attitude

SLACK = 0.5  # m that a sensor may stand outside the box of its carrier: poses of real vehicles err
UNSEEN = (np.array([0.0, 0.0, 0.75]), np.array([2.45, 1.06, 0.75]))
"""Centre and half extent of a connected vehicle that no agent lists: a Lincoln MKZ, as all connected ones of OPV2V."""

Key = TypeVar("Key", int, tuple[int, int])


@dataclass
class Track:
    """One object through a scene; NaN where it is not listed."""

    pose: Float[np.ndarray, "T 3"]  # of the box centre; m, m, rad
    z: Float[np.ndarray, " T"]  # of the box centre; m
    tilt: Float[np.ndarray, "T 2"]  # roll and pitch of the box; rad
    base: Float[np.ndarray, " T"]  # height of the road under it; m
    center: Float[np.ndarray, " 3"]  # of its box from its origin, where it is listed first
    extent: Float[np.ndarray, " 3"]  # half of length, width, height
    kind: str | None

    @classmethod
    def blank(
        cls, frames: int, center: Float[np.ndarray, " 3"], extent: Float[np.ndarray, " 3"], kind: str | None
    ) -> Track:
        """One that is listed nowhere yet."""
        blank = np.full((frames, 7), np.nan)
        return cls(blank[:, :3], blank[:, 3], blank[:, 4:6], blank[:, 6], center, extent, kind)

    def put(self, t: int, world_T_body: Float[np.ndarray, "3 4"], center: Float[np.ndarray, " 3"], base: float) -> None:
        """Where it is in frame t: the pose of its origin, its box's middle from there, and the road's height."""
        middle = world_T_body @ np.append(center, 1.0)
        yaw, roll, pitch = attitude(world_T_body[:, :3])
        self.pose[t], self.z[t], self.tilt[t], self.base[t] = (*middle[:2], yaw), middle[2], (roll, pitch), base

    def copy(self) -> Track:
        """The same track over arrays of its own."""
        return replace(self, pose=self.pose.copy(), z=self.z.copy(), tilt=self.tilt.copy(), base=self.base.copy())

    def boxes(self) -> Float[np.ndarray, "T 7"]:
        """x, y, z of the middle, length, width, height, yaw; m, rad."""
        size = np.broadcast_to(2 * self.extent, (len(self.z), 3))
        return np.concatenate([self.pose[:, :2], self.z[:, None], size, self.pose[:, 2:]], axis=1)


def under_sensor(sensor: Float[np.ndarray, "T 3"], tracks: Mapping[Key, Track]) -> tuple[set[Key], Track]:
    """A connected vehicle whose number is not known: whatever stands under its sensor wherever it is listed.

    In frames where nothing is listed there, its box stands to its sensor as it mostly does in the others, upright, and
    its height is left to be found; where nothing ever is listed, one of a usual size stands in the middle under it.

    Args:
        sensor: x, y and heading in the world; m, m, rad.
        tracks: by key.

    Returns:
        The keys under which it is listed, and its track, without gaps but in height.
    """
    keys: dict[Key, int] = {}
    for key, track in tracks.items():
        within = compose(invert(track.pose), sensor)[:, :2]
        inside = (np.abs(within) <= track.extent[:2] + SLACK).all(axis=1)  # a NaN compares false
        if 2 * inside.sum() > np.isfinite(track.base).sum():
            keys[key] = int(inside.sum())
    order = sorted(keys, key=lambda key: (-keys[key], key))
    first = tracks[order[0]] if order else None
    own = Track.blank(len(sensor), *((first.center, first.extent, first.kind) if first else (*UNSEEN, None)))
    for key in order:
        new = np.isnan(own.base) & np.isfinite(tracks[key].base)
        for mine, theirs in (
            (own.pose, tracks[key].pose),
            (own.z, tracks[key].z),
            (own.tilt, tracks[key].tilt),
            (own.base, tracks[key].base),
        ):
            mine[new] = theirs[new]
    absent = np.isnan(own.base)
    shift = np.zeros(3)
    if not absent.all():
        apart: Float[np.ndarray, "F 3"] = compose(invert(sensor[~absent]), own.pose[~absent])
        turn = np.arctan2(np.median(np.sin(apart[:, 2])), np.median(np.cos(apart[:, 2])))
        shift = np.array([*np.median(apart[:, :2], axis=0), turn])
    own.pose[absent] = compose(sensor[absent], np.broadcast_to(shift, (int(absent.sum()), 3)))
    own.tilt[absent] = 0.0
    return set(order), own
