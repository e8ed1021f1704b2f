"""Figures of recorded scenes: vehicles, shares parked, standing and hidden, similarity of consecutive frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields

import numpy as np
from jaxtyping import Float

from cp_env.metrics.ground_truth import rows_in_range, truth_boxes
from cp_env.metrics.similarity import jaccard_many
from cp_env.types import Scene, SceneSource

EXTENT = 32.0  # m
SEEN = 3  # returns that make a vehicle count as seen
_FRAMES = range(4, 100, 13)


@dataclass(frozen=True)
class Figures:
    """Means over one scene; the last three count vehicles within ±32 m of the ego."""

    vehicles: float  # in range of the ego
    parked: float  # share of them
    standing: float  # share of the moving kind that stand
    travel: float  # m driven by the ego
    company: float  # m to the first four connected others
    jaccard: float  # of the true boxes of consecutive frames
    alone: float  # share of vehicles in range that the ego's LiDAR meets
    five: float  # ... that one of five vehicles' does
    all: float  # ... that any of all vehicles or the road-side unit does


def describe(source: SceneSource, name: str) -> Figures:
    """Figures of one scene; casts the LiDAR on every 13th frame."""
    scene = source.load(name)
    ego = int(scene.connected[0])
    place = scene.pose[:, scene.connected, :2]
    moves = np.isnan(scene.pose).any(axis=(0, 2)) | (np.ptp(scene.pose[..., :2], axis=0).max(axis=1) > 0)
    step = np.linalg.norm(np.diff(scene.pose[..., :2], axis=0), axis=2)
    alone, five, everyone = sight(scene, _FRAMES)
    rows = [rows_in_range(scene, t, ego, EXTENT) for t in range(scene.n_frames)]
    drives = np.concatenate([step[t, r[moves[r]]] for t, r in enumerate(rows[:-1])])
    return Figures(
        vehicles=float(np.mean([len(r) for r in rows])),
        parked=float(1 - np.mean([moves[r].mean() for r in rows])),
        standing=float((drives < 0.04).mean()) if len(drives) else 0.0,
        travel=float(step[:, ego].sum()),
        company=float(np.linalg.norm(place[:, 1:5] - place[:, :1], axis=2).mean()),
        jaccard=_calm(scene, ego),
        alone=alone,
        five=five,
        all=everyone,
    )


def _calm(scene: Scene, ego: int) -> float:
    boxes = [truth_boxes(scene, t, ego, EXTENT) for t in range(scene.n_frames)]
    shift = np.diff(scene.pose[:, ego, :2], axis=0)
    moved = [np.concatenate([new[:, :2] + by, new[:, 2:]], axis=1) for new, by in zip(boxes[1:], shift, strict=True)]
    return float(jaccard_many(boxes[:-1], moved).mean())


def sight(scene: Scene, frames: Sequence[int]) -> Float[np.ndarray, " 3"]:
    """Share of the vehicles in the ego's range that the LiDAR meets: the ego's, one of five vehicles', anyone's."""
    from cp_env import lidar  # torch is heavy

    ego = int(scene.connected[0])
    seen = np.zeros(3)
    total = 0
    for frame, sweeps in zip(frames, lidar.scan([(scene, frame) for frame in frames]), strict=True):
        hits = np.array([sweep.hits for sweep in sweeps]) >= SEEN
        hits[np.arange(scene.n_connected), scene.connected] = True  # the carrier knows where it is
        rows = rows_in_range(scene, frame, ego, EXTENT)
        total += len(rows)
        seen += [hits[:n_sensors, rows].any(axis=0).sum() for n_sensors in (1, 5, len(hits))]
    return seen / max(total, 1)


def table(source: SceneSource) -> str:
    """One line a scene and the split's mean, as text."""
    names = [field.name for field in fields(Figures)]
    head = f"{source.name:28}" + "".join(f"{name:>10}" for name in names)
    rows = {name: np.array(astuple(describe(source, name))) for name in source.names()}
    kinds = sorted({source.load(name).kind for name in rows})
    for kind in kinds:
        rows[f"mean {kind}"] = np.mean([row for name, row in rows.items() if f"-{kind}-" in name], axis=0)
    rows["mean"] = np.mean([rows[f"mean {kind}"] for kind in kinds], axis=0)
    return "\n".join([head, *(f"{name:28}" + "".join(f"{value:10.2f}" for value in row) for name, row in rows.items())])
