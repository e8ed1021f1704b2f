"""Confidence intervals of shares: means of values in [0, 1], and average precision, from few scenes.

Student's t and the bootstrap read the spread off the sample. Six episodes of an attack that wins in one of ten are, as
often as not, six episodes that it lost: the sample has no spread, and both then hold the truth in half of the cases.
Gaffke's bound does not guess. It weighs the n values and one more at the end of the scale by a flat Dirichlet
distribution; the upper limit is a quantile of that weighted mean with the further value at 1, the lower one with it
at 0. So the interval never leaves [0, 1], has width even where all values are equal, and is that of Clopper and Pearson
where all values are 0 or 1.

N. Gaffke, "Three test statistics for a nonparametric one-sided hypothesis on the mean of a nonnegative variable",
Mathematical Methods of Statistics 14 (2005). That it always covers is conjectured (E. Learned-Miller and P. Thomas,
arXiv:1905.06208, who found the same bound), and proved for close relatives (M. Phan and others, "Towards Practical Mean
Bounds for Small Samples", ICML 2021). `python benchmarks/intervals.py` prints how often it does on samples like ours.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from cp_env.metrics.intervals import (
    Interval,
    Statistic,
    checked_confidence,
    checked_values,
    rate_interval,
    t_interval,
)

DRAWS = 10_000
"""Dirichlet weights from which a quantile is read: a limit at 0.975 lies between 0.972 and 0.978. Our choice."""
MANY = 500
"""From so many values on, Student's t does as well on any share. Our choice."""
ROUNDING = 1e-9
"""So far outside of its range a share may be: the mean of ones is not always 1."""
COPIES = 1000
"""Into so many rows a pooled figure's weights are rounded."""


def share_interval(values: ArrayLike, *, confidence: float = 0.95, whole: float = 1.0) -> Interval:
    """Mean of independent values in [0, whole], with Gaffke's interval.

    Args:
        values: any shape.
        confidence: in (0, 1).
        whole: the largest value that is possible: 1, or 100 for percent.

    Returns:
        The interval, within [0, whole]. A single value has none (see `Interval`).

    Raises:
        ValueError: no value, a value that is not finite or outside [0, whole], or a confidence outside (0, 1).
    """
    array = np.sort(checked_values(values)) / whole
    tail, n = (1 - checked_confidence(confidence)) / 2, array.size
    if array[0] < -ROUNDING or array[-1] > 1 + ROUNDING:
        outside = whole * float(array[0] if array[0] < 0 else array[-1])
        raise ValueError(f"a share lies in [0, {whole:g}]; got {outside:g}: a count has `t_interval`")
    array = array.clip(0, 1)
    mean = float(array.mean())
    if n == 1:
        low = high = mean
    elif ((array == 0) | (array == 1)).all():
        exact = rate_interval(int(array.sum()), n, confidence=confidence)
        low, high = exact.low, exact.high
    elif n >= MANY:
        plain = t_interval(array, confidence=confidence)
        low, high = max(plain.low, 0.0), min(plain.high, 1.0)
    else:
        weights = _weights(n)
        inside = weights[:, :n] @ array
        low = min(float(np.quantile(inside, tail)), mean)
        high = max(float(np.quantile(inside + weights[:, n], 1 - tail)), mean)
    return Interval(mean * whole, low * whole, high * whole, n)


def pooled_share_interval(
    statistic: Statistic,
    worst: Statistic,
    best: Statistic,
    n: int,
    *,
    seed: int,
    resamples: int = 1000,
    confidence: float = 0.95,
) -> Interval:
    """A share that is pooled over n scenes, as average precision is, with Gaffke's interval carried over to it.

    In place of one more value there is one more scene. That the interval covers is measured, not proved.

    Args:
        statistic: of the rows of scenes, numbers below n; repeats count again.
        worst: the same where row n is one more scene, in which nothing was right.
        best: the same where row n is one more scene, in which everything was right.
        n: scenes.
        seed: of the weights.
        resamples: number of weights.
        confidence: in (0, 1).

    Returns:
        The interval round the figure of every scene once.

    Raises:
        ValueError: n or resamples below 1, or a confidence outside (0, 1).
    """
    if n < 1 or resamples < 1:
        raise ValueError(f"a pooled share needs at least one scene and one resample; got n={n}, resamples={resamples}")
    tail = (1 - checked_confidence(confidence)) / 2
    mean = float(statistic(np.arange(n)))
    if n == 1:
        return Interval(mean, mean, mean, 1)
    weights = np.random.default_rng(seed).dirichlet(np.ones(n + 1), resamples)
    rows = [np.repeat(np.arange(n + 1), counts) for counts in np.rint(COPIES * weights).astype(int)]
    low = float(np.quantile([worst(chosen) for chosen in rows], tail))
    high = float(np.quantile([best(chosen) for chosen in rows], 1 - tail))
    return Interval(mean, min(low, mean), max(high, mean), n)


@lru_cache(maxsize=8)
def _weights(n: int) -> Float[np.ndarray, "D m"]:
    """Flat Dirichlet weights of n values and one more; the same ones whenever they are asked for."""
    return np.random.default_rng(n).dirichlet(np.ones(n + 1), DRAWS)
