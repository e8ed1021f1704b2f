"""Traffic and streets without a simulator."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import shapely

from cp_env.scenes.sumo import network, selection, traffic


def line_of_cars(n: int, spacing: float, frames: int = selection.FRAMES) -> traffic.Tracks:
    """A queue along x that stands still."""
    pose = np.zeros((frames, n, 3))
    pose[..., 0] = spacing * np.arange(n)
    return traffic.Tracks(pose, np.tile([4.0, 1.8, 1.5], (n, 1)))


def town_without_streets(radius: float) -> network.Streets:
    return network.Streets(Path(), [], shapely.Polygon(), np.zeros((0, 3)), [], [], np.zeros(2), radius)
