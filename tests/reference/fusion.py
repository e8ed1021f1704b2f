"""Slow twins of the fusions without weights: one cell, one member at a time."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

Twin = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def cells(
    of_members: Callable[..., np.ndarray],
    received: np.ndarray,
    coverage: np.ndarray,
    world: np.ndarray,
    groups: np.ndarray,
) -> np.ndarray:
    """received [E, N, C, H, W], coverage [E, N, H, W], world [B], groups [B, N] -> [B, C, H, W]."""
    _, n, channels, height, width = received.shape
    fused = np.zeros((len(world), channels, height, width))
    for b, e in enumerate(world):
        for row in range(height):
            for col in range(width):
                members = [i for i in range(n) if groups[b, i] and coverage[e, i, row, col] > 0]
                if members:
                    fused[b, :, row, col] = of_members(received[e, members, :, row, col], axis=0)
    return fused


FUSIONS: dict[str, Twin] = {
    "mean": partial(cells, np.mean),
    "max": partial(cells, np.max),
    "sum": partial(cells, np.sum),
}
