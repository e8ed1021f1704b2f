"""Similarity models: how similar a group's view is to a right reference in a simulated world.

A `SimilarityModel` is called once in a frame for every group that is queried. It is given the group, its active
attackers and a generator, and returns the similarity, in [0, 1], of the group's view to a right reference. Three models
are given here. A model of your own may depend on the members of the group, for example to frame a benign vehicle.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

Group = frozenset[int]
Key = tuple[int, int]  # size of a group, active attackers in it
SimilarityModel = Callable[[Group, Group, np.random.Generator], float]
T = TypeVar("T")


def exact(group: Group, active: Group, rng: np.random.Generator) -> float:
    """A perfect verifier: similarity 1 if no attacker of the group is active, and 0 otherwise."""
    return 0.0 if active else 1.0


@dataclass(frozen=True)
class ErrorRates:
    """A binary verifier with errors: similarity 1 or 0, not always the right one.

    Errors of different groups and frames are independent. A group that is queried twice in a frame gets one answer.

    Attributes:
        false_fail: Probability that an uncontaminated group fails.
        false_pass: Probability that a contaminated group passes. Each rate is a number, a mapping from
            (size, attackers) to a number, or a function of size and attackers.
    """

    false_fail: float | Mapping[Key, float] | Callable[[int, int], float] = 0.0
    false_pass: float | Mapping[Key, float] | Callable[[int, int], float] = 0.0

    def __post_init__(self) -> None:
        for name in ("false_fail", "false_pass"):
            rate = getattr(self, name)
            for value in rate.values() if isinstance(rate, Mapping) else () if callable(rate) else (rate,):
                _check_unit(name, value)

    def __call__(self, group: Group, active: Group, rng: np.random.Generator) -> float:
        """Similarity 1 or 0. ValueError for a group without a rate, and for a rate outside [0, 1]."""
        rate = self.false_pass if active else self.false_fail
        key = len(group), len(active)
        if callable(rate):
            rate = _check_unit("an error rate", rate(*key))
        elif isinstance(rate, Mapping):
            rate = _known(rate, key)
        return float((rng.random() < rate) == bool(active))


@dataclass(frozen=True)
class Measured:
    """Measured similarities: for every view one value of `samples[size, attackers]` is drawn, each equally likely.

    Nothing is interpolated. A distribution in closed form is a `SimilarityModel` of its own:
    `lambda group, active, rng: rng.beta(...)`.
    """

    samples: Mapping[Key, Sequence[float] | np.ndarray]

    def __post_init__(self) -> None:
        for key, values in self.samples.items():
            array = np.asarray(values, dtype=np.float64)
            if not array.size or not ((array >= 0) & (array <= 1)).all():
                raise ValueError(f"samples of (size, attackers) = {key} must be one or more similarities in [0, 1]")

    def __call__(self, group: Group, active: Group, rng: np.random.Generator) -> float:
        """A similarity. ValueError for a group without samples."""
        values = _known(self.samples, (len(group), len(active)))
        return float(values[int(rng.integers(len(values)))])


def _known(table: Mapping[Key, T], key: Key) -> T:
    if key not in table:
        raise ValueError(
            f"nothing is known of groups of {key[0]} with {key[1]} attackers; add {key}, or pass a function"
        )
    return table[key]


def _check_unit(name: str, value: float) -> float:
    if not 0 <= value <= 1:
        raise ValueError(f"{name} must be a probability in [0, 1], got {value}")
    return value
