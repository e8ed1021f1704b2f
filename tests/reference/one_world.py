"""One frame of one world as the paper's formulas, with no batching and no cache: the slow twin of World.step."""

from __future__ import annotations

import numpy as np
import torch

from cp_env.detector import Detector
from cp_env.geometry.planar import grid_origin
from cp_env.types import SceneSource, View
from cp_env.world.episode import ego_place, make_views


def ego_view(
    detector: Detector,
    source: SceneSource,
    name: str,
    frame: int,
    group: frozenset[int],
    perturbations: dict[int, torch.Tensor],
    budget: float,
) -> View:
    """The ego's view of `group` when vehicle i sends f_E(C_i) + clip(perturbations[i]) (Eq. 1, L∞ ball)."""
    scene = source.load(name)
    sweeps = source.sweeps(scene, [frame])[0]
    origins = grid_origin(scene.pose[frame, scene.connected, :2])
    total = torch.zeros(detector.channels, detector.size, detector.size)
    count = torch.zeros(detector.size, detector.size)
    with torch.no_grad():
        for i in sorted(group):
            shared = detector.encode([sweeps[i]])[0].half().float()  # the channel carries half precision
            shared = shared + perturbations.get(i, torch.zeros(1)).clamp(-budget, budget)
            pose = torch.tensor([*(origins[i] - origins[0]), 0.0], dtype=torch.float32)
            covered = detector.coverage(pose[None])[0]
            total += detector.warp(shared[None], pose[None])[0] * covered
            count += covered
        dense = detector.decode((total / count.clamp(min=1))[None])
    return make_views(detector, dense, [group], [frame], [ego_place(scene, frame)])[0]


def boxes_of(view: View) -> np.ndarray:
    """Boxes and scores side by side, in an order that does not depend on ties."""
    table = np.column_stack([view.detections.boxes, view.detections.scores])
    return table[np.lexsort(table.T[::-1])]
