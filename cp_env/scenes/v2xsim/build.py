"""One scene of tables in the nuScenes format: boxes become vehicles, sensors find their carriers and the road."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int

from cp_env.geometry import spatial
from cp_env.scenes.assembly.road import under_unit
from cp_env.scenes.assembly.tilt import foot
from cp_env.scenes.town import KINDS
from cp_env.scenes.v2xsim.index import Index, Rows
from cp_env.types import Scene

RSU = 0  # the road-side unit is LIDAR_TOP_id_0
STRAY = 2.5  # m; an annotated box this close under a LiDAR is its carrier's
BARE = (4.7, 2.0, 1.6)  # length, width, height of a carrier that is not annotated; m


@dataclass(frozen=True)
class Bare:
    """The box of a carrier that is not annotated.

    Attributes:
        size: length, width, height; m.
        ahead: m that its middle lies ahead of the ego pose; None if it stands under its sensor, and looks as that does.
    """

    size: tuple[float, float, float]
    ahead: float | None


UNDER = Bare(BARE, None)
UNLISTED = "not annotated"  # the class of such a carrier


@dataclass(frozen=True, eq=False)
class FrameSequence:
    """A scene, and what it takes to read its sweeps."""

    scene: Scene
    rows: Rows
    agents: tuple[int, ...]  # channels in the order of the sweeps
    row: dict[int, int]  # of each vehicle's box among the scene's vehicles
    origin: dict[int, Float[np.ndarray, "T 3"]]  # of each agent's sweeps; world x, y and height above ground
    ground: Float[np.ndarray, "T K"]  # world z of the ground under each sensor
    feet: Float[np.ndarray, "T M 3"]  # of the scene's vehicles, in the world
    boxes: Float[np.ndarray, "T M 7"]  # of the scene's vehicles, as in `Rows.box`
    tilt: Float[np.ndarray, "T M 2"]  # roll and pitch of those boxes; rad
    classes: tuple[str, ...]  # of the scene's vehicles: their categories' names


def present(rows: Rows) -> Int[np.ndarray, " A"]:
    """The vehicles with a sweep in every frame."""
    there = ~np.isnan(rows.world_T_sensor[..., 0, 0]).any(axis=0)
    there[RSU] = False
    return np.flatnonzero(there)


@lru_cache(maxsize=8)
def build(index: Index, place: int, categories: tuple[str, ...], rsu: bool, bare: Bare = UNDER) -> FrameSequence:
    """A scene of an index."""
    rows, entry = index.rows(place), index.entries[place]
    agents = present(rows).tolist()
    tracks, category = _tracks(rows)
    carriers = [_carrier(tracks, rows.world_T_sensor[:, agent, :, 3]) for agent in agents]
    boxes = np.concatenate([tracks, *(_bare(rows, agent, bare) for agent in agents)], axis=1)
    row = [len(tracks[0]) + k if carrier is None else carrier for k, carrier in enumerate(carriers)]
    names = [*(index.categories[number] for number in category), *[UNLISTED] * len(agents)]
    wanted = np.flatnonzero([name.startswith(categories) for name in names[: len(category)]])
    keep = np.union1d(wanted.astype(np.int64), row)
    boxes, tilt = np.split(boxes[:, keep], [7], axis=2)
    connected = np.searchsorted(keep, row)
    carrier = dict(zip(agents, connected.tolist(), strict=True))
    feet = np.concatenate([boxes[..., :2], foot(boxes, tilt)[..., None]], axis=2)
    ground = _ground(rows, feet, carrier)
    height = rows.world_T_sensor[..., 2, 3] - ground
    origin = {
        agent: np.concatenate([boxes[:, own, :2], height[:, agent, None]], axis=1) for agent, own in carrier.items()
    }
    mast = None
    if rsu and not np.isnan(height[:, RSU]).any():
        mast = np.append(rows.world_T_sensor[0, RSU, :2, 3], height[0, RSU])
        origin[RSU] = np.repeat(mast[None], len(height), axis=0)
    scene = Scene(
        name=entry.name,
        kind=entry.description if entry.description in KINDS else "intersection",
        dt=round(float(np.median(np.diff(rows.time))), 6) if len(rows.time) > 1 else 0.2,
        pose=boxes[..., [0, 1, 6]],
        size=np.nanmedian(boxes[..., 3:6], axis=0),
        connected=connected,
        rsu=mast,
        obstacles=np.zeros((0, 6)),
    )
    for array in (scene.pose, scene.size, scene.connected, scene.obstacles):
        array.flags.writeable = False  # it is shared by all who load it
    classes = tuple(names[number] for number in keep)
    return FrameSequence(scene, rows, tuple(origin), carrier, origin, ground, feet, boxes, tilt, classes)


def _tracks(rows: Rows) -> tuple[Float[np.ndarray, "T I 9"], Int[np.ndarray, " I"]]:
    """The box, roll and pitch of each instance in each frame (NaN where absent), and each instance's category."""
    ids, first, column = np.unique(rows.instance, return_index=True, return_inverse=True)
    tracks = np.full((len(rows.time), len(ids), 9), np.nan)
    tracks[rows.frame, column] = np.concatenate([rows.box, rows.tilt], axis=1)
    return tracks, rows.category[first]


def _carrier(tracks: Float[np.ndarray, "T I 9"], sensor: Float[np.ndarray, "T 3"]) -> int | None:
    """The instance that stays under a sensor in all frames, if there is one."""
    away = np.hypot(*np.moveaxis(tracks[..., :2] - sensor[:, None, :2], -1, 0)).max(axis=0, initial=0)
    if not (away < STRAY).any():  # a NaN, absent in some frame, compares false
        return None
    return int(np.nanargmin(away))


def _bare(rows: Rows, agent: int, bare: Bare) -> Float[np.ndarray, "T 1 9"]:
    """An upright box for a carrier that is not annotated, on its ego pose."""
    world_T_sensor, world_T_ego = rows.world_T_sensor[:, agent], rows.world_T_ego[:, agent]
    yaw = spatial.heading(world_T_sensor if bare.ahead is None else world_T_ego)
    if bare.ahead is None:
        place = world_T_sensor[:, :2, 3]
    else:
        place = world_T_ego[:, :2, 3] + bare.ahead * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    middle = world_T_ego[:, 2, 3, None] + bare.size[2] / 2
    size = np.broadcast_to(bare.size, (len(place), 3))
    return np.concatenate([place, middle, size, yaw[:, None], np.zeros((len(place), 2))], axis=1)[:, None]


def _ground(rows: Rows, feet: Float[np.ndarray, "T M 3"], carrier: dict[int, int]) -> Float[np.ndarray, "T K"]:
    """World z of the ground under each sensor."""
    ground = rows.world_T_ego[..., 2, 3].copy()
    for agent, row in carrier.items():
        ground[:, agent] = feet[:, row, 2]
    mast = rows.world_T_sensor[0, RSU, :2, 3]
    if not np.isnan(mast).any() and not np.isnan(level := under_unit(feet, mast)):
        ground[:, RSU] = level
    return ground
