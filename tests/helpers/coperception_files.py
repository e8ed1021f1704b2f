"""Detection files as coperception's preprocessing writes them, from any source: slow, for tests only.

Own code after the public one's conventions: voxels by floor, trans_matrices[j] = own_T_j between LiDARs, targets in the
sensor's frame mirrored (u = -x), cars up to 32.5 m away in either direction, the carrier among them; every anchor whose
centre is near a car's is given that car. `tests/cp_env/scenes/v2xsim/test_preprocessed.py` has a file worked by hand.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from cp_env.types import Scene, SceneSource, Sweep

ANCHORS = [
    (2, 4, 0),
    (2, 4, math.pi / 2),
    (2, 4, -math.pi / 4),
    (3, 12, 0),
    (3, 12, math.pi / 2),
    (3, 12, -math.pi / 4),
]


def write_files(source: SceneSource, root: Path, split: str, numbers: dict[str, int]) -> None:
    """Every frame of the scenes in `numbers`; agents without a sweep get the scalar 0."""
    for name, number in numbers.items():
        scene = source.load(name)
        for t, sweeps in enumerate(source.sweeps(scene, range(scene.n_frames))):
            poses = _poses(scene, t, sweeps)
            for agent in range(6):
                path = root / split / f"agent{agent}" / f"{number}_{t}" / "0.npy"
                path.parent.mkdir(parents=True)
                content: Any = 0
                if agent in poses:
                    sweep = sweeps[-1] if agent == 0 else sweeps[agent - 1]
                    content = _content(scene, t, agent, sweep, poses)
                np.save(path, content)


def _poses(scene: Scene, t: int, sweeps: list[Sweep]) -> dict[int, np.ndarray]:
    """world_T_sensor, 4 × 4, by agent."""
    yaws = {0: 0.3, **{k + 1: scene.pose[t, row, 2] for k, row in enumerate(scene.connected)}}
    order = [*range(1, scene.n_connected + 1), 0]
    poses = {}
    for agent, sweep in zip(order, sweeps, strict=True):
        c, s = math.cos(yaws[agent]), math.sin(yaws[agent])
        x, y, z = sweep.origin
        poses[agent] = np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, z], [0, 0, 0, 1]])
    return poses


def _content(scene: Scene, t: int, agent: int, sweep: Sweep, poses: dict[int, np.ndarray]) -> dict[str, Any]:
    own_T_world = np.linalg.inv(poses[agent])
    matrices = np.stack([own_T_world @ poses[j] if j in poses else np.zeros((4, 4)) for j in range(6)])
    points = (sweep.points - (0, 0, sweep.origin[2])) @ poses[agent][:3, :3]
    low, high = np.array([[-32.0, -32.0, -8.0], [32.0, 32.0, -3.0]])
    if agent:
        low[2], high[2] = -3.0, 2.0
    points = points[((points > low) & (points < high)).all(axis=1)]
    cell = np.array([0.25, 0.25, 0.4])
    voxels = np.unique(np.floor(points / cell) - np.floor(low / cell), axis=0).astype(np.int32)
    yaw = math.atan2(own_T_world[1, 0], own_T_world[0, 0])
    boxes = []
    for pose, (length, width, _) in zip(scene.pose[t], scene.size, strict=True):
        x, y = own_T_world[:2, :2] @ pose[:2] + own_T_world[:2, 3]
        if max(abs(x), abs(y)) <= 32.5:
            boxes.append((x, y, width, length, pose[2] + yaw))
    labels, targets, allocated, best = targets_of(boxes)
    return {
        "voxel_indices_0": voxels,
        "reg_target_sparse": targets[allocated][:, None],
        "label_sparse": labels[allocated],
        "allocation_mask": allocated,
        "gt_max_iou": best,
        "reg_loss_mask": labels[..., None] > 0,
        "target_agent_id": agent,
        "num_sensor": len(poses),
        "trans_matrices": matrices,
    }


def targets_of(boxes: list[tuple[float, ...]]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    owner = np.full((256, 256, 6), -1)
    centre = (np.arange(256) + 0.5) * 0.25 - 32
    nearest = np.full((256, 256), np.inf)
    best = []
    for number, (x, y, _, length, _) in enumerate(boxes):
        away = np.hypot(centre[None, :] + x, centre[:, None] - y)  # [i, j]: row by v = y, column by u = -x
        mine = (away < max(1.0, length / 5)) & (away < nearest)
        owner[mine] = number
        nearest[mine] = away[mine]
        i, j = np.unravel_index(int(away.argmin()), away.shape)
        best.append((i, j, 0, 1))
    targets = np.zeros((256, 256, 6, 6))
    for i, j, k in np.argwhere(owner >= 0):
        x, y, width, length, yaw = boxes[owner[i, j, k]]
        w, h, turn = ANCHORS[k]
        angle = yaw + math.pi / 2
        targets[i, j, k] = (
            (centre[j] + x) / (width + 1e-6),
            (centre[i] - y) / (length + 1e-6),
            math.log(w / (width + 1e-6)),
            math.log(h / (length + 1e-6)),
            math.sin(angle - turn),
            math.cos(angle - turn),
        )
    return (owner >= 0).astype(np.int8), targets, owner >= 0, np.array(best)
