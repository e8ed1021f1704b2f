"""The arithmetic of PRBI, Eqs. (8)-(14): the number of attackers, their probabilities, and the stopping test.

These are pure functions of counts. The paper keeps one N for all vehicles. Here every vehicle has its own, because the
divide and conquer of the first abnormal frame verifies some vehicles more often than others. With equal N the formulas
are the paper's.

    normal     c_normal = β_j, successful validations of vehicle j
    total      N, validations of vehicle j
    abnormal   c_abnormal = N - β_j
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int

Counts = Int[np.ndarray, " n"]


def benign_ratio(normal: Counts, total: Counts) -> float:
    """η, Eq. (8): the share of validations that were normal."""
    return float(normal.sum() / total.sum())


def estimate_attackers(normal: Counts, total: Counts) -> float:
    """m, Eq. (9) with the cap of line 20: log2(1 / η), at most n - 1. It is n - 1 while nothing was normal."""
    most = len(normal) - 1.0
    eta = benign_ratio(normal, total)
    return most if eta == 0 else min(math.log2(1 / eta), most)


def posterior(
    previous: Float[np.ndarray, " n"], normal: Counts, total: Counts, *, gamma: float, lam: float
) -> Float[np.ndarray, " n"]:
    """P_benign, Eqs. (10)-(12). Zero exactly where a vehicle was never part of a normal validation.

    Where the paper is silent: with no abnormal detection at all (P(A) = 0) the evidence is void and the prior is
    returned; values above 1, which Eq. (10) gives to vehicles that look better than average, are kept.
    """
    abnormal = total - normal
    seen = np.maximum(total, 1)
    prior: Float[np.ndarray, " n"] = gamma * previous + lam * normal / seen  # P(B_j), Eq. (12)
    if not abnormal.any():
        return prior
    others = np.maximum(total.sum() - total, 1)
    likelihood = (abnormal.sum() - abnormal) / others  # P(A | B_j), Eq. (11)
    attack = float(abnormal.sum() / total.sum())  # P(A)
    prior *= likelihood / attack  # Eq. (10)
    return prior


def round_attackers(m: float, rounding: str) -> int:
    """⌊m⌋, the nearest integer (halves upwards) or ⌈m⌉. Theorem 2 gives the limit of m for each."""
    if rounding == "floor":
        return math.floor(m)
    return math.floor(m + 0.5) if rounding == "nearest" else math.ceil(m)


def settled(window: Sequence[float], m: float, alpha: float) -> bool:
    """First condition of convergence, Eq. (14): the window's mean does not differ significantly from m.

    Where the paper is silent: one sample has no variance, so it settles nothing; samples that are all equal (S = 0)
    are settled exactly when they equal m.
    """
    count = len(window)
    if count < 2:
        return False
    mean, deviation = float(np.mean(window)), float(np.std(window, ddof=1))
    if deviation == 0.0:
        return math.isclose(mean, m)
    return abs(mean - m) / (deviation / math.sqrt(count)) <= upper_quantile(alpha, count - 1)


@lru_cache
def upper_quantile(alpha: float, freedom: int) -> float:
    """t_{α/2} with `freedom` degrees of freedom."""
    from scipy.special import stdtrit  # here, because scipy takes longer to import than all defenders together

    return float(stdtrit(freedom, 1 - alpha / 2))


def check_options(*, window: int, alpha: float, gamma: float, lam: float) -> None:
    """ValueError unless the numbers make sense in Eqs. (12) and (14)."""
    if window < 2:
        raise ValueError(f"window is the number of values a t-test needs, at least 2, got {window}")
    if not 0 < alpha < 1:
        raise ValueError(f"alpha is a significance level between 0 and 1, got {alpha}")
    if not (gamma >= 0 and lam > 0):
        raise ValueError(f"gamma must be at least 0 and lam above 0, or nobody is ever benign; got {gamma} and {lam}")
