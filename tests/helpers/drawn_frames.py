"""Frames drawn by hand: a picture of nothing, boxes where a test wants them, and the colours around a spot."""

from __future__ import annotations

import numpy as np

from cp_env.rendering.picture import Picture
from cp_env.types import Detections

CAR = (4.5, 1.8, 0.3)


def boxes(*centres: tuple[float, float]) -> np.ndarray:
    """A car at each centre."""
    return np.array([(x, y, *CAR) for x, y in centres]).reshape(-1, 5)


def detections(*centres: tuple[float, float]) -> Detections:
    """The same as a detector's output."""
    return Detections(boxes(*centres), np.ones(len(centres)))


NOTHING = Picture(
    frame=3,
    points=[np.zeros((0, 3))],
    places=np.zeros((1, 2)),
    truth=boxes(),
    seen=detections(),
    output=detections(),
    attackers=frozenset(),
    suspects=frozenset(),
    collaborators=frozenset({0}),
    similarity=(),
    verifications=0,
    damage=0.0,
)


def colours_in(
    image: np.ndarray, corner: tuple[int, int], side: int, x: float, y: float, radius: int = 14
) -> set[tuple[int, ...]]:
    """The colours around a point (m) of the panel at `corner` (left, top), which shows 64 m; north is up."""
    column, row = (int(corner[0] + (x + 32) * side / 64), int(corner[1] + (32 - y) * side / 64))
    patch = image[max(row - radius, 0) : row + radius, max(column - radius, 0) : column + radius].reshape(-1, 3)
    return {tuple(int(v) for v in pixel) for pixel in patch}
