"""One scene of coperception's detection files put together: frames have no common world but the road-side unit's.

Convention: the world is the frame of the road-side unit's LiDAR, which stands still; boxes lie flat in it. A sensor
that pitches or rolls gives x, y and heading of a box in its own frame. They are taken for those of a vehicle on level
road at the height of the ground under the sensor, which fixes the z that the files leave out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from cp_env.geometry import spatial
from cp_env.scenes.assembly.tilt import level
from cp_env.scenes.assembly.tracking import follow
from cp_env.scenes.errors import BrokenData
from cp_env.scenes.formats.safe_pickle import load_pickled
from cp_env.scenes.v2xsim.anchors import ANCHORS, CELLS, SLICES, decode, distinct, voxel_points
from cp_env.scenes.v2xsim.build import BARE, RSU, STRAY

AGENTS = 6
REACH = 5.0  # m; a vehicle is at most so far from where its last two places would have it
_KEYS = (
    "voxel_indices_0",
    "trans_matrices",
    "reg_target_sparse",
    "label_sparse",
    "allocation_mask",
    "target_agent_id",
)
HEIGHT = BARE[2]  # m; the files do not hold a vehicle's height


@dataclass(frozen=True, eq=False)
class FrameSequence:
    """What a scene's files say; agents are numbered as the files' folders, NaN where one is absent."""

    world_T_sensor: Float[np.ndarray, "T K 3 4"]
    ground: Float[np.ndarray, " K"]  # z of the ground in each sensor's frame; m
    agents: Int[np.ndarray, " A"]  # the vehicles present in every frame
    pose: Float[np.ndarray, "T M 3"]  # of all vehicles; those of `agents` first, in order
    size: Float[np.ndarray, "M 2"]  # length, width


def read_points(path: Path, agent: int) -> Float[np.ndarray, "P 3"]:
    """The middles of the voxels an agent found occupied, in its sensor's frame; m.

    Raises:
        BrokenData: the file is missing, of another kind, or holds no points.
    """
    content = _open(path)
    if content is None:
        raise BrokenData(path, "the agent is absent here, it was not when the scene was put together")
    return _points(path, content, agent)


def _open(path: Path) -> dict[str, Any] | None:
    """What a file holds; None if the agent is absent."""
    content = load_pickled(path)
    if isinstance(content, np.integer | int) and content == 0:
        return None
    if not isinstance(content, dict):
        raise BrokenData(path, f"it holds a {type(content).__name__}; a dict of arrays or 0 is expected")
    missing = [key for key in _KEYS if key not in content]
    if missing:
        raise BrokenData(path, f"it lacks {missing[0]!r}")
    return content


def _points(path: Path, content: dict[str, Any], agent: int) -> Float[np.ndarray, "P 3"]:
    voxels = np.asarray(content["voxel_indices_0"])
    if voxels.ndim != 2 or voxels.shape[1] != 3 or not len(voxels):
        raise BrokenData(path, "an empty sweep")
    try:
        return voxel_points(voxels, rsu=agent == RSU)
    except ValueError as error:
        raise BrokenData(path, str(error)) from error


def _pose(path: Path, content: dict[str, Any], agent: int) -> Float[np.ndarray, "3 4"]:
    """Of the sensor in the frame of the road-side unit's."""
    owner, poses = content["target_agent_id"], np.asarray(content["trans_matrices"], dtype=np.float64)
    if owner != agent:
        raise BrokenData(path, f"it is of agent {owner}, not {agent}")
    if poses.shape != (AGENTS, 4, 4) or not poses[RSU].any():
        raise BrokenData(path, "trans_matrices lack the road-side unit: V2X-Sim 1.0? Version 2.0 is read")
    if not np.isfinite(poses).all():
        raise BrokenData(path, "trans_matrices hold a pose that is no finite number")
    return spatial.inverse(poses[RSU, :3])


def _boxes(path: Path, content: dict[str, Any]) -> Float[np.ndarray, "L 5"]:
    """Those that anchors were given, in the sensor's frame."""
    targets = np.asarray(content["reg_target_sparse"], dtype=np.float64)
    allocated, labels = np.asarray(content["allocation_mask"], dtype=bool), np.asarray(content["label_sparse"])
    if allocated.shape != (CELLS, CELLS, len(ANCHORS)) or not len(targets) == len(labels) == allocated.sum():
        raise BrokenData(path, "its targets are not those of six anchors a cell on 256 × 256 cells")
    if not np.isfinite(targets).all():
        raise BrokenData(path, "reg_target_sparse holds a box that is no finite number")
    return decode(targets.reshape(-1, 6), allocated, labels)


def read_sequence(paths: Sequence[Sequence[Path | None]]) -> FrameSequence:
    """Put a scene together from the files `[frame][agent]`; BrokenData for what is wrong with one of them."""
    shape = len(paths), AGENTS
    world_T_sensor = np.full((*shape, 3, 4), np.nan)
    slices = np.zeros((AGENTS, SLICES), dtype=np.int64)
    seen: list[list[tuple[int, Float[np.ndarray, "_ 5"]]]] = [[] for _ in paths]  # [frame]: agent, boxes
    for t, row in enumerate(paths):
        for agent, path in enumerate(row):
            content = None if path is None else _open(path)
            if path is None or content is None:
                continue
            world_T_sensor[t, agent] = _pose(path, content, agent)
            _points(path, content, agent)
            slices[agent] += np.bincount(content["voxel_indices_0"][:, 2], minlength=SLICES)
            seen[t].append((agent, _boxes(path, content)))
    there = ~np.isnan(world_T_sensor[..., 0, 0]).any(axis=0)
    agents = np.array([k for k in range(AGENTS) if k != RSU and there[k]], dtype=np.int64)
    fullest = np.stack([np.zeros(AGENTS), np.zeros(AGENTS), slices.argmax(axis=1)], axis=1).astype(np.int64)
    ground = np.array([voxel_points(fullest[k : k + 1], rsu=k == RSU)[0, 2] for k in range(AGENTS)])
    boxes = [
        distinct(
            np.concatenate([np.zeros((0, 5)), *(in_world(b, world_T_sensor[t, k], float(ground[k])) for k, b in found)])
        )
        for t, found in enumerate(seen)
    ]
    carriers = [_carrier(boxes, world_T_sensor[:, agent]) for agent in agents.tolist()]
    pose, size = _track(boxes)
    own = np.stack([track[:, [0, 1, 4]] for track in carriers], axis=1) if carriers else np.zeros((shape[0], 0, 3))
    own_size = np.array([np.median(track[:, 2:4], axis=0) for track in carriers]).reshape(-1, 2)
    return FrameSequence(
        world_T_sensor,
        ground,
        agents,
        np.concatenate([own, pose], axis=1),
        np.concatenate([own_size, size]),
    )


def in_world(
    boxes: Float[np.ndarray, "L 5"], world_T_sensor: Float[np.ndarray, "3 4"], ground: float
) -> Float[np.ndarray, "L 5"]:
    """Boxes of a sensor's frame (x, y, length, width, yaw) in the world: of vehicles that stand on level road.

    Args:
        boxes: as the sensor's frame shows them; m, rad.
        world_T_sensor: the sensor's pose, which may pitch and roll.
        ground: z of the ground in the sensor's frame; m.
    """
    turn, middle = world_T_sensor[:, :3], ground * world_T_sensor[2, 2] + HEIGHT / 2
    ahead = level(np.stack([np.cos(boxes[:, 4]), np.sin(boxes[:, 4])], axis=1), turn, 0.0)
    laid = boxes.copy()
    laid[:, :2] = level(boxes[:, :2], turn, middle) + world_T_sensor[:2, 3]
    laid[:, 4] = np.arctan2(ahead[:, 1], ahead[:, 0])
    return laid


def _carrier(boxes: list[Float[np.ndarray, "_ 5"]], world_T_sensor: Float[np.ndarray, "T 3 4"]) -> np.ndarray:
    """The box under a sensor in every frame (T × 5), taken out of `boxes`; one of a usual size where there is none."""
    track = np.concatenate(
        [world_T_sensor[:, :2, 3], np.tile(BARE[:2], (len(boxes), 1)), spatial.heading(world_T_sensor)[:, None]], axis=1
    )
    for t, there in enumerate(boxes):
        away = np.hypot(*(there[:, :2] - track[t, :2]).T)
        if len(away) and away.min() < STRAY:
            nearest = int(away.argmin())
            track[t] = there[nearest]
            boxes[t] = np.delete(there, nearest, axis=0)
    return track


def _track(boxes: list[Float[np.ndarray, "_ 5"]]) -> tuple[Float[np.ndarray, "T M 3"], Float[np.ndarray, "M 2"]]:
    """Poses and sizes of vehicles followed from frame to frame: the files number none."""
    tracks = follow(boxes, reach=REACH)
    pose = np.full((len(boxes), len(tracks), 3), np.nan)
    size = np.empty((len(tracks), 2))
    for m, track in enumerate(tracks):
        for t, b in track.items():
            pose[t, m] = boxes[t][b][[0, 1, 4]]
        size[m] = np.median([boxes[t][b][2:4] for t, b in track.items()], axis=0)
    return pose, size
