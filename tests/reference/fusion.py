"""Slow twin of `cp_env.detector.fusion`: one cell, one member at a time."""

from __future__ import annotations

import numpy as np


def mean(received: np.ndarray, coverage: np.ndarray, world: np.ndarray, groups: np.ndarray) -> np.ndarray:
    """As `fusion.mean`: received [E, N, C, H, W], coverage [E, N, H, W], world [B], groups [B, N] -> [B, C, H, W]."""
    _, n, channels, height, width = received.shape
    fused = np.zeros((len(world), channels, height, width))
    for b, e in enumerate(world):
        for row in range(height):
            for col in range(width):
                members = [i for i in range(n) if groups[b, i] and coverage[e, i, row, col] > 0]
                for i in members:
                    fused[b, :, row, col] += received[e, i, :, row, col] / len(members)
    return fused
