"""When liars lie: from a world's frame numbers to whether it is attacked in that frame."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Int

Schedule = Callable[[Int[np.ndarray, " E"]], Bool[np.ndarray, " E"]]


def always(frame: Int[np.ndarray, " E"]) -> Bool[np.ndarray, " E"]:
    """Every frame, the paper's Table 3."""
    return np.ones_like(frame, dtype=np.bool_)


def every(period: int, *, start: int = 0) -> Schedule:
    """Frames `start`, `start + period`, …: the intermittent attacks of the paper's Table 6."""
    if period < 1 or start < 0:
        raise ValueError(f"a schedule needs period >= 1 and start >= 0, got period={period}, start={start}")
    return lambda frame: (frame >= start) & ((frame - start) % period == 0)


def since(start: int) -> Schedule:
    """Honest until frame `start`, lying from then on."""
    return every(1, start=start)
