"""Samples as the evaluation has them: damage in [0, 1] with masses near 0 and 1, shares, counts with long tails."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from cp_env.evaluation.plan.records import PooledApMeter

Draw = Callable[[np.random.Generator, tuple[int, ...]], Float[np.ndarray, "..."]]


@dataclass(frozen=True)
class Family:
    """A distribution and its mean."""

    draw: Draw
    mean: float


def _beta(a: float, b: float) -> Family:
    return Family(lambda rng, size: rng.beta(a, b, size), a / (a + b))


def _lognormal(sigma: float) -> Family:
    return Family(lambda rng, size: rng.lognormal(0, sigma, size), float(np.exp(sigma**2 / 2)))


def _two_masses(high: float) -> Family:
    """Near 0.9 with probability `high`, else near 0.1: the ego is an attacker or it is not, the attack wins or not."""

    def draw(rng: np.random.Generator, size: tuple[int, ...]) -> Float[np.ndarray, "..."]:
        return np.where(rng.random(size) < high, rng.beta(18, 2, size), rng.beta(2, 18, size))

    return Family(draw, 0.9 * high + 0.1 * (1 - high))


def _event(probability: float) -> Family:
    return Family(lambda rng, size: (rng.random(size) < probability).astype(np.float64), probability)


SHARES: dict[str, Family] = {
    "beta(2, 2)": _beta(2, 2),
    "beta(2, 5)": _beta(2, 5),
    "beta(1, 4)": _beta(1, 4),
    "beta(0.5, 0.5)": _beta(0.5, 0.5),
    "beta(0.5, 2)": _beta(0.5, 2),
    "beta(0.3, 2)": _beta(0.3, 2),
    "near 0.1 or 0.9, 4 in 10 high": _two_masses(0.4),
    "near 0.1 or 0.9, 2 in 10 high": _two_masses(0.2),
    "near 0.1 or 0.9, 1 in 10 high": _two_masses(0.1),
    "0 or 1, 4 in 10": _event(0.4),
    "0 or 1, 1 in 10": _event(0.1),
}
"""In [0, 1]."""

COUNTS: dict[str, Family] = {
    "normal": Family(lambda rng, size: rng.normal(3, 2, size), 3.0),
    "geometric, mean 3.3": Family(lambda rng, size: rng.geometric(0.3, size).astype(np.float64), 1 / 0.3),
    "log-normal, σ = 0.5": _lognormal(0.5),
    "log-normal, σ = 1": _lognormal(1.0),
}
"""Without an upper bound."""

FOUND: dict[str, Callable[[np.random.Generator], float]] = {
    "clean": lambda rng: rng.beta(18, 3),
    "middling": lambda rng: rng.beta(2, 2),
    "high, or low in 4 of 10": lambda rng: rng.beta(18, 3) if rng.random() < 0.6 else rng.beta(1, 18),
    "low": lambda rng: rng.beta(0.5, 4),
}
"""Share of a scene's vehicles that is found."""


def scene(rng: np.random.Generator, kind: str) -> PooledApMeter:
    """A scene of detections: numbers of vehicles, found ones and ghosts differ much from one to the next."""
    n_truth, found = 4 * int(rng.poisson(rng.gamma(4, 2))) + 1, FOUND[kind](rng)
    hits = int(rng.binomial(n_truth, found))
    ghosts = int(rng.poisson(n_truth * (0.1 + 0.5 * (1 - found))))
    scores = np.concatenate([rng.beta(4, 2, hits), rng.beta(2, 3, ghosts)])
    right = np.arange(hits + ghosts) < hits
    return PooledApMeter(scores, {0.5: right, 0.7: right}, n_truth, 20)
