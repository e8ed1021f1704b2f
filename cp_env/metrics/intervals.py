"""95 % confidence intervals: Student's t over independent values, the bootstrap over scenes for pooled figures."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Int
from numpy.typing import ArrayLike
from scipy.special import stdtrit


@dataclass(frozen=True)
class Interval:
    """A figure and how far it can be trusted. From a single value nothing is known of the spread: low = high = mean."""

    mean: float
    low: float
    high: float
    n: int  # values (or scenes) it rests on

    def __format__(self, spec: str) -> str:
        """`f"{interval:.3f}"` is "0.812 [0.790, 0.833]", and "0.812 (n=1)" for a single value; `.3f` by default."""
        spec = spec or ".3f"
        mean = format(self.mean, spec)
        if self.n < 2:
            return f"{mean} (n={self.n})"
        return f"{mean} [{format(self.low, spec)}, {format(self.high, spec)}]"

    def __str__(self) -> str:
        return format(self, "")


def t_interval(values: ArrayLike, *, confidence: float = 0.95) -> Interval:
    """Mean of independent values, with Student's t interval on n - 1 degrees of freedom.

    Raises:
        ValueError: no value, a value that is not finite, or a confidence outside (0, 1).
    """
    array = np.asarray(values, dtype=np.float64).ravel()
    if not array.size:
        raise ValueError("an interval needs at least one value; got none")
    if not np.isfinite(array).all():
        raise ValueError(f"values must be finite; got {array[~np.isfinite(array)][0]} among {array.size}")
    n, mean = array.size, float(array.mean())
    quantile = float(stdtrit(max(n - 1, 1), 0.5 + _checked(confidence) / 2))
    reach = quantile * float(array.std(ddof=1)) / math.sqrt(n) if n > 1 else 0.0
    return Interval(mean, mean - reach, mean + reach, n)


def bootstrap_interval(
    statistic: Callable[[Int[np.ndarray, " n"]], float],
    n: int,
    *,
    seed: int,
    resamples: int = 1000,
    confidence: float = 0.95,
) -> Interval:
    """A pooled figure over `n` scenes, with the percentile interval over resampled scenes.

    `statistic(rows)` is the figure for the scenes `rows` (numbers below n, repeats counted again): for AP it is
    `metrics.resampled_ap(meters, iou)`; `mean` is its value for every scene once.

    Raises:
        ValueError: n or resamples below 1, a confidence outside (0, 1), or a statistic that is not finite.
    """
    if n < 1 or resamples < 1:
        raise ValueError(f"a bootstrap needs at least one scene and one resample; got n={n}, resamples={resamples}")
    tail = (1 - _checked(confidence)) / 2
    mean = float(statistic(np.arange(n)))
    rng = np.random.default_rng(seed)
    draws = np.array([statistic(rng.integers(n, size=n)) for _ in range(resamples if n > 1 else 1)])
    if not (math.isfinite(mean) and np.isfinite(draws).all()):
        raise ValueError("the statistic must be finite for every resample: give it a value where it is undefined")
    low, high = np.quantile(draws, [tail, 1 - tail])
    return Interval(mean, float(low), float(high), n)


def _checked(confidence: float) -> float:
    if not 0 < confidence < 1:
        raise ValueError(f"confidence is a probability strictly between 0 and 1; got {confidence}")
    return confidence
