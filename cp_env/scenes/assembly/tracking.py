"""Vehicles followed from frame to frame where a data set numbers none."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment

_NEVER = 1e6


def follow(boxes: Sequence[Float[np.ndarray, "_ 5"]], *, reach: float, alike: float = 0.01) -> list[dict[int, int]]:
    """The tracks of vehicles: of each, the number of its box in every frame it is in.

    A vehicle keeps its size and is met next near where its last two places would have it; the pairing of least total
    distance is taken. One that is not met again is over; should it come back, it is a new one.

    Args:
        boxes: of each frame: x, y, length, width, yaw; m, rad.
        reach: m, from where it would be to where it is, at most.
        alike: m, by which its length and width may change from one frame to the next.
    """
    tracks: list[dict[int, int]] = []
    live: list[int] = []
    for t, there in enumerate(boxes):
        due = np.array([_due(boxes, tracks[k], t) for k in live]).reshape(-1, 5)
        cost = np.hypot(*(due[:, None, :2] - there[None, :, :2]).T).T
        unlike = (np.abs(due[:, None, 2:4] - there[None, :, 2:4]) > alike).any(axis=-1)
        cost[unlike | (cost > reach)] = _NEVER
        met = {b: live[a] for a, b in zip(*linear_sum_assignment(cost), strict=True) if cost[a, b] < _NEVER}
        for b in range(len(there)):
            if b not in met:
                met[b] = len(tracks)
                tracks.append({})
            tracks[met[b]][t] = b
        live = list(met.values())
    return tracks


def _due(boxes: Sequence[Float[np.ndarray, "_ 5"]], track: dict[int, int], t: int) -> Float[np.ndarray, " 5"]:
    """Where a vehicle met in frame t - 1 would be in frame t if it kept its pace."""
    last = boxes[t - 1][track[t - 1]]
    due: Float[np.ndarray, " 5"] = last.copy()
    if t - 2 in track:
        due[:2] += last[:2] - boxes[t - 2][track[t - 2]][:2]
    return due
