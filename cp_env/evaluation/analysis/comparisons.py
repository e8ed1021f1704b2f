"""Paired comparisons of entries that played the same episodes: same scene, same start, same attackers, same seed.

What a hard scene costs both of them drops out of the difference. Where many pairs are compared at once, Holm's
correction keeps the probability of even one false verdict at the level (S. Holm, Scandinavian Journal of Statistics 6,
1979). Below `FEWEST` scenes no pair is told apart: with three of them, values that are close to 0 or 1 make equal
differences by chance, and Student's test then errs in up to a third of the tables (`python benchmarks/intervals.py`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike
from scipy.special import stdtr

from cp_env.metrics.intervals import Interval, checked_values, t_interval

LEVEL = 0.05
"""Of a table of comparisons: the probability that it holds even one false verdict."""
FEWEST = 6
"""Scenes from which on entries are told apart. Our choice, from the table that the benchmark prints."""
SMALL = 1e-12
"""Differences that are equal up to this have no spread."""


@dataclass(frozen=True)
class Difference:
    """How much more of a value one entry has than another, over the scenes that both have played."""

    first: str
    second: str
    interval: Interval  # of first - second: this pair by itself
    p: float  # Student's paired test, two-sided
    adjusted: float  # the same after Holm's correction over the pairs of its table

    @property
    def told_apart(self) -> bool:
        """Whether the two differ, at `LEVEL` for the whole table."""
        return self.adjusted < LEVEL


def paired_difference(first: ArrayLike, second: ArrayLike) -> tuple[Interval, float]:
    """The mean difference of two entries over the same scenes, and the probability of one as large by chance.

    Args:
        first: values [S], one a scene.
        second: values [S] of the same scenes in the same order.

    Returns:
        Student's interval of first - second, and the p of his two-sided test; 1 for fewer than `FEWEST` scenes.

    Raises:
        ValueError: no scene, not the same number of them, or a value that is not finite.
    """
    a, b = checked_values(first), checked_values(second)
    if a.shape != b.shape:
        raise ValueError(f"a paired difference needs the same scenes of both; got {a.size} and {b.size}")
    differences = a - b
    if np.ptp(differences) < SMALL:
        differences = np.full_like(differences, differences.mean())
    interval = t_interval(differences)
    if a.size < FEWEST:
        return interval, 1.0
    spread = float(differences.std(ddof=1)) / math.sqrt(a.size)
    if spread < SMALL:
        return interval, 1.0 if abs(interval.mean) < SMALL else 0.0
    return interval, float(2 * stdtr(a.size - 1, -abs(interval.mean) / spread))


def holm(p_values: ArrayLike) -> Float[np.ndarray, " m"]:
    """Holm's adjusted p-values: sorted upwards, the i-th of m times m - i + 1, never below one before, at most 1.

    Raises:
        ValueError: a value that is not in [0, 1].
    """
    p = np.asarray(p_values, dtype=np.float64).ravel()
    if not ((p >= 0) & (p <= 1)).all():
        raise ValueError(f"p-values lie in [0, 1]; got {p}")
    order, adjusted = np.argsort(p), np.empty_like(p)
    adjusted[order] = np.minimum(np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1)), 1.0)
    return adjusted


def compare(values: Mapping[str, Mapping[str, float]]) -> list[Difference]:
    """Every pair of entries, with Holm's correction over all of them.

    Args:
        values: by entry and scene.

    Returns:
        A difference for each pair, in the order of the entries.

    Raises:
        ValueError: entries of different scenes.
    """
    found = []
    for first, second in combinations(values, 2):
        if values[first].keys() != values[second].keys():
            raise ValueError(f"{first!r} and {second!r} have not played the same scenes: compare those that both have")
        pair = [(values[first][scene], values[second][scene]) for scene in values[first]]
        interval, p = paired_difference([a for a, _ in pair], [b for _, b in pair])
        found.append(Difference(first, second, interval, p, p))
    return adjust(found)


def adjust(differences: Sequence[Difference]) -> list[Difference]:
    """The differences with Holm's correction over all of them."""
    adjusted = holm([difference.p for difference in differences])
    return [replace(of, adjusted=float(p)) for of, p in zip(differences, adjusted, strict=True)]
