"""Straight roads built by hand, and views of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cp_env.types import Detections, Scene, View

SIZE = (4.0, 2.0, 1.5)
"""Of every vehicle; m."""


def road(tracks: Sequence[Sequence[tuple[float, float, float]]], dt: float = 0.2) -> Scene:
    """A scene of vehicles of 4 m x 2 m with these poses (x, y, yaw) in each frame; the first is the ego."""
    pose = np.array(tracks, dtype=np.float64).transpose(1, 0, 2)
    n = pose.shape[1]
    connected, size = np.array([0]), np.tile(np.array(SIZE), (n, 1))
    return Scene("road", "urban", dt, pose, size, connected, None, np.zeros((0, 6)))


def driving(
    x: float, y: float, speed: float, frames: int, yaw: float = 0.0, dt: float = 0.2
) -> list[tuple[float, ...]]:
    """The track of a vehicle that keeps its speed (m/s) along its heading."""
    step = speed * dt
    return [(x + t * step * np.cos(yaw), y + t * step * np.sin(yaw), yaw) for t in range(frames)]


def boxes_at(*places: tuple[float, float]) -> np.ndarray:
    """Boxes of 4 m x 2 m along x."""
    return np.array([[x, y, 4.0, 2.0, 0.0] for x, y in places]).reshape(-1, 5)


def view_of(boxes: np.ndarray, origin: Sequence[float] = (0.0, 0.0), frame: int = 0) -> View:
    """A view with these boxes in its grid frame."""
    found = Detections(boxes, np.linspace(0.9, 0.6, len(boxes)))
    return View(frozenset({0}), frame, np.array(origin, dtype=np.float64), found, found, np.zeros((2, 2)))
