"""Success of targeted attacks: the nearest vehicle removed, or a car spoofed in the ego's way.

The targets are the same for every attack, so that attacks that aim at nothing in particular can be compared, too: the
vehicle nearest to the ego in its corridor (or nearest at all if that is empty), and the place where a standing car
would be critical. What the unattacked output gets wrong by itself is no success.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float

from cp_env.metrics.critical import found
from cp_env.metrics.severity import ghosts
from cp_env.metrics.surroundings import Surroundings


def removable(clean: Float[np.ndarray, "C 5"], around: Surroundings) -> bool:
    """Whether there is a target that the unattacked output finds."""
    row = around.nearest
    return row is not None and bool(found(clean, around.boxes[[row]])[0])


def removed(boxes: Float[np.ndarray, "B 5"], clean: Float[np.ndarray, "C 5"], around: Surroundings) -> bool:
    """Whether the output misses the nearest vehicle, which the unattacked one finds (IoU of at least 0.5)."""
    row = around.nearest
    return row is not None and removable(clean, around) and not found(boxes, around.boxes[[row]])[0]


def spoofed(boxes: Float[np.ndarray, "B 5"], clean: Float[np.ndarray, "C 5"], around: Surroundings) -> bool:
    """Whether the output holds a critical ghost, and the unattacked one holds none.

    A ghost has no true vehicle within 2 m. It is critical where a standing vehicle would be.
    """
    return bool(ghosts(boxes, around).critical.any()) and not ghosts(clean, around).critical.any()


def longest_streak(success: Iterable[bool | int]) -> int:
    """The most consecutive frames of success."""
    best = run = 0
    for one in success:
        run = run + 1 if one else 0
        best = max(best, run)
    return best
