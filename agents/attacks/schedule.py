"""Schedules of an attack: the frames in which it attacks, and the share of the budget, by a world's frame numbers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, Int

from agents.attacks.spec import named

Schedule = Callable[[Int[np.ndarray, " E"]], Bool[np.ndarray, " E"]]
"""Whether each world is attacked in its frame."""

BudgetSchedule = Callable[[Int[np.ndarray, " E"]], Float[np.ndarray, " E"]]
"""The share of Δ, 0 to 1, that may be used in each world's frame."""


def always(frame: Int[np.ndarray, " E"]) -> Bool[np.ndarray, " E"]:
    """Every frame, the paper's Table 3."""
    return np.ones_like(frame, dtype=np.bool_)


def full_budget(frame: Int[np.ndarray, " E"]) -> Float[np.ndarray, " E"]:
    """All of the budget, in every frame."""
    return np.ones_like(frame, dtype=np.float32)


def every(period: int, start: int = 0) -> Schedule:
    """Frames `start`, `start + period`, …: the intermittent attacks of the paper's Table 6."""
    if period < 1 or start < 0:
        raise ValueError(f"a schedule needs period >= 1 and start >= 0, got period={period}, start={start}")
    return lambda frame: (frame >= start) & ((frame - start) % period == 0)


def since(start: int) -> Schedule:
    """Benign until frame `start`, under attack from then on."""
    return every(1, start)


SCHEDULES: dict[str, Callable[..., Schedule]] = {"always": lambda: always, "every": every, "since": since}


def make_schedule(schedule: str | Schedule) -> Schedule:
    """A schedule by name, or the function itself.

    Args:
        schedule: `always`, `every@period`, `every@period:start`, `since@start`, or a schedule.

    Returns:
        The schedule.

    Raises:
        ValueError: an unknown name, or numbers that it does not take.
    """
    return named("schedule", schedule, SCHEDULES) if isinstance(schedule, str) else schedule
