"""Scores of groups by their size and the attackers in them, and the thresholds that separate benign from contaminated.

The threshold of a size is the one that errs least: it minimises the mean of the share of benign groups that fail and
the share of groups with an attacker that pass. The latter is averaged over the numbers of attackers, so that each
number has the same weight.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

import numpy as np
from jaxtyping import Float

Key = tuple[int, int]
"""Size of the group, attackers in it."""

Samples = dict[Key, dict[str, list[float]]]
"""Scores by key and by scene."""

T = TypeVar("T")
Track = Callable[[Sequence[T], str], Iterable[T]]
"""Hands on the items one by one, and says how far it is; the text says what is done."""


def no_samples() -> Samples:
    """A table to be filled."""
    return defaultdict(lambda: defaultdict(list))


def pooled(samples: Samples, key: Key) -> Float[np.ndarray, " S"]:
    """The scores of a key, of all scenes."""
    return np.concatenate(list(samples[key].values()))


def errors(samples: Samples, size: int, epsilon: float, *, strict: bool) -> tuple[float, float]:
    """Shares of benign groups that fail, and of groups with an attacker that pass, averaged over k.

    Args:
        samples: the scores.
        size: of the groups.
        epsilon: the threshold.
        strict: a group passes above ε (PASAC), else at ε already (PRBI, ROBOSAC).
    """
    benign = pooled(samples, (size, 0))
    contaminated = [pooled(samples, key) for key in sorted(samples) if key[0] == size and key[1] > 0]

    def passing(scores: Float[np.ndarray, " S"]) -> float:
        return float((scores > epsilon).mean() if strict else (scores >= epsilon).mean())

    return 1 - passing(benign), float(np.mean([passing(scores) for scores in contaminated]))


def best_threshold(samples: Samples, size: int, grid: Float[np.ndarray, " G"], *, strict: bool, digits: int) -> float:
    """The middle of the values on the grid that err least, rounded."""
    wrong = np.array([sum(errors(samples, size, float(e), strict=strict)) for e in grid])
    best = np.flatnonzero(np.isclose(wrong, wrong.min()))
    return round(float(grid[best].mean()), digits)
