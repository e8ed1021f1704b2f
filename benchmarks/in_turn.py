"""Two pieces of work timed in turn, so that what else the machine does slows both."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class InTurn:
    """Processor seconds of each round."""

    work: tuple[float, ...]
    bound: tuple[float, ...]

    @property
    def ratio(self) -> float:
        """Median over the rounds of work / bound."""
        return statistics.median(w / b for w, b in zip(self.work, self.bound, strict=True))

    def each(self, units: int) -> tuple[float, float]:
        """Milliseconds of work and of bound for one of `units`, medians."""
        return tuple(1e3 * statistics.median(times) / units for times in (self.work, self.bound))  # type: ignore[return-value]


def in_turn(
    work: Callable[[], object],
    bound: Callable[[], object],
    *,
    rounds: int,
    setup: Callable[[], object] = lambda: None,
    warmup: int = 2,
) -> InTurn:
    """Time `work` and `bound` in turn.

    Args:
        work: what is measured.
        bound: what it is compared with.
        rounds: how often each is timed.
        setup: done before each `work`, outside the clock.
        warmup: rounds before, which do not count.

    Returns:
        The times of the rounds.
    """
    times: list[tuple[float, float]] = []
    for _ in range(warmup + rounds):
        setup()
        start = time.process_time()
        work()
        middle = time.process_time()
        bound()
        times.append((middle - start, time.process_time() - middle))
    work_times, bound_times = zip(*times[warmup:], strict=True)
    return InTurn(work_times, bound_times)
