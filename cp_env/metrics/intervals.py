"""95 % confidence intervals, and the table of how often each of them holds the true value.

Which one is for what, by `python benchmarks/intervals.py` (share of samples whose interval holds the truth):

    a share, a mean of values in [0, 1]   `metrics.shares`: at least 0.96 on every sample that was tried, from n = 3 on
    a count, a mean of values >= 0        `t_interval`: 0.95 on normal samples, less on skewed ones, as the table says
    so many of n episodes                 `rate_interval`: Clopper and Pearson, at least 0.95 by construction
    any other pooled figure               `jackknife_interval`: Student's t over what each scene changes
    a figure over a hundred episodes      `bootstrap_interval`: BCa, from `scipy.stats`
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike
from scipy import stats
from scipy.special import stdtrit

Statistic = Callable[[Int[np.ndarray, " n"]], float]
"""A pooled figure, given the rows of the scenes that count; a row that is named twice counts twice."""

BATCH = 1 << 20
"""Row numbers that the bootstrap holds at once."""


@dataclass(frozen=True)
class Interval:
    """A figure and how far it can be trusted. From a single value nothing is known of the spread: low = high = mean."""

    mean: float
    low: float
    high: float
    n: int  # values, scenes or episodes it rests on
    hits: int | None = None  # of the n episodes of a rate: it is then printed as "0 of 9"

    def __format__(self, spec: str) -> str:
        """`f"{interval:.3f}"` is "0.812 [0.790, 0.833]"; `.3f` by default.

        A single value is "0.812 (n=1)", a rate "0 of 9 [0.000, 0.336]".
        """
        spec = spec or ".3f"
        mean = format(self.mean, spec) if self.hits is None else f"{self.hits} of {self.n}"
        if self.n < 2:
            return f"{mean} (n=1)" if self.hits is None else mean
        return f"{mean} [{format(self.low, spec)}, {format(self.high, spec)}]"

    def __str__(self) -> str:
        return format(self, "")


def t_interval(values: ArrayLike, *, confidence: float = 0.95, least: float = -math.inf) -> Interval:
    """Mean of independent values, with Student's t interval on n - 1 degrees of freedom.

    Args:
        values: any shape.
        confidence: in (0, 1).
        least: no value can be below; the interval is cut there.

    Returns:
        The interval.

    Raises:
        ValueError: no value, a value that is not finite or below `least`, or a confidence outside (0, 1).
    """
    array = checked_values(values)
    if array.min() < least:
        raise ValueError(f"no value may be below {least:g}; got {array.min():g}")
    n, mean = array.size, float(array.mean())
    reach = _reach(float(array.std(ddof=1)), n, confidence) if n > 1 else 0.0 * checked_confidence(confidence)
    return Interval(mean, max(mean - reach, least), mean + reach, n)


def jackknife_interval(statistic: Statistic, n: int, *, confidence: float = 0.95) -> Interval:
    """A pooled figure over n scenes, with Student's t over its jackknife values (Tukey 1958).

    The figure is computed without each scene in turn. Its standard error follows from how far that moves it. For a mean
    this is `t_interval`.

    Args:
        statistic: of the rows of scenes, numbers below n.
        n: scenes.
        confidence: in (0, 1).

    Returns:
        The interval round the figure of all scenes.

    Raises:
        ValueError: n below 1, a confidence outside (0, 1), or a statistic that is not finite.
    """
    if n < 1:
        raise ValueError(f"a pooled figure needs at least one scene; got n={n}")
    rows = np.arange(n)
    mean = float(statistic(rows))
    left_out = np.array([statistic(np.delete(rows, row)) for row in rows]) if n > 1 else np.array([mean])
    _check_finite(mean, left_out)
    reach = _reach((n - 1) * float(left_out.std(ddof=1)), n, confidence) if n > 1 else 0.0
    return Interval(mean, mean - reach, mean + reach, n)


def bootstrap_interval(
    statistic: Statistic,
    n: int,
    *,
    seed: int,
    resamples: int = 1000,
    confidence: float = 0.95,
) -> Interval:
    """A pooled figure over `n` scenes, with the BCa interval of `scipy.stats.bootstrap` over resampled scenes.

    BCa is the bootstrap corrected for bias and skew (Efron 1987). It is for many scenes or episodes: with 6 values that
    are normal it covers 0.87. Where every resample gives the same figure the interval has no width.

    Args:
        statistic: of the rows of scenes: numbers below n, repeats counted again.
        n: scenes.
        seed: of the resamples.
        resamples: number of them.
        confidence: in (0, 1).

    Returns:
        The interval round the figure of every scene once.

    Raises:
        ValueError: n or resamples below 1, a confidence outside (0, 1), or a statistic that is not finite.
    """
    if n < 1 or resamples < 1:
        raise ValueError(f"a bootstrap needs at least one scene and one resample; got n={n}, resamples={resamples}")
    checked_confidence(confidence)
    rows = np.arange(n)
    mean = float(statistic(rows))
    _check_finite(mean)
    if n == 1:
        return Interval(mean, mean, mean, 1)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")  # of a spread of nothing, which is dealt with below
        found = stats.bootstrap(
            (rows,),
            statistic,
            vectorized=False,
            n_resamples=resamples,
            batch=max(1, BATCH // n),
            confidence_level=confidence,
            method="BCa",
            random_state=np.random.default_rng(seed),
        )
    draws = found.bootstrap_distribution
    _check_finite(mean, draws)
    low, high = found.confidence_interval
    if not (math.isfinite(low) and math.isfinite(high)):  # BCa has no answer where scenes do not differ
        low, high = np.quantile(draws, [(1 - confidence) / 2, (1 + confidence) / 2])
    return Interval(mean, float(min(low, mean)), float(max(high, mean)), n)


def rate_interval(hits: int, n: int, *, confidence: float = 0.95) -> Interval:
    """Share of n independent episodes in which something happened, with the exact bounds of Clopper and Pearson (1934).

    0 of 9 is at most 0.336, and 9 of 9 at least 0.664.

    Raises:
        ValueError: n below 1, hits that are not in 0 … n, or a confidence outside (0, 1).
    """
    if n < 1 or not 0 <= hits <= n:
        raise ValueError(f"a rate is of at least one episode, and hits are 0 to n; got {hits} of {n}")
    found = stats.binomtest(hits, n).proportion_ci(checked_confidence(confidence), method="exact")
    return Interval(hits / n, float(found.low), float(found.high), n, hits)


def checked_values(values: ArrayLike) -> Float[np.ndarray, " n"]:
    """The values in a row. ValueError if there is none, or one that is not finite."""
    array = np.asarray(values, dtype=np.float64).ravel()
    if not array.size:
        raise ValueError("an interval needs at least one value; got none")
    if not np.isfinite(array).all():
        raise ValueError(f"values must be finite; got {array[~np.isfinite(array)][0]} among {array.size}")
    return array


def checked_confidence(confidence: float) -> float:
    """The confidence. ValueError unless it lies strictly between 0 and 1."""
    if not 0 < confidence < 1:
        raise ValueError(f"confidence is a probability strictly between 0 and 1; got {confidence}")
    return confidence


def _reach(spread: float, n: int, confidence: float) -> float:
    """Half the width of Student's interval for n values of that standard deviation."""
    return float(stdtrit(n - 1, 0.5 + checked_confidence(confidence) / 2)) * spread / math.sqrt(n)


def _check_finite(mean: float, draws: ArrayLike = ()) -> None:
    if not (math.isfinite(mean) and np.isfinite(draws).all()):
        raise ValueError("the statistic must be finite for every resample: give it a value where it is undefined")
