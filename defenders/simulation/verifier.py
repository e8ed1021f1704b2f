"""What a view resembles in a world without scenes: how like a right view it is, from who is in it and who lies.

A `Likeness` is called once for every group looked at in a frame, with the group, those of it that lie in this frame and
a generator, and gives the similarity (in [0, 1]) of the group's view to a right reference. Three are given here; a
function of your own may look at who is in the group, say to frame an innocent.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

Group = frozenset[int]
Key = tuple[int, int]  # size of a group, liars in it
Likeness = Callable[[Group, Group, np.random.Generator], float]
T = TypeVar("T")


def exact(group: Group, lying: Group, rng: np.random.Generator) -> float:
    """A perfect verifier: alike (1) if nobody in the group lies, nothing in common (0) otherwise."""
    return 0.0 if lying else 1.0


@dataclass(frozen=True)
class ErrorRates:
    """A verifier that errs: a view looks right (1) or wrong (0), not always as it should.

    false_fail  probability that a group without a liar looks wrong
    false_pass  probability that a group with a liar looks right

    Each is a number, a mapping from (size, liars) to one, or a function of size and liars. Every group errs by itself
    in every frame; asked twice in a frame it looks the same.
    """

    false_fail: float | Mapping[Key, float] | Callable[[int, int], float] = 0.0
    false_pass: float | Mapping[Key, float] | Callable[[int, int], float] = 0.0

    def __post_init__(self) -> None:
        for name in ("false_fail", "false_pass"):
            rate = getattr(self, name)
            for value in rate.values() if isinstance(rate, Mapping) else () if callable(rate) else (rate,):
                _check_unit(name, value)

    def __call__(self, group: Group, lying: Group, rng: np.random.Generator) -> float:
        """1 or 0. ValueError for a group that no rate is known of, and for a rate outside [0, 1]."""
        rate = self.false_pass if lying else self.false_fail
        key = len(group), len(lying)
        if callable(rate):
            rate = _check_unit("an error rate", rate(*key))
        elif isinstance(rate, Mapping):
            rate = _known(rate, key)
        return float((rng.random() < rate) == bool(lying))


@dataclass(frozen=True)
class Measured:
    """Similarities as they were measured: one value of `samples[size, liars]` is drawn for every view.

    Between the samples nothing is interpolated: the draw is of one of them, each as likely. A distribution in closed
    form is a `Likeness` of its own: `lambda group, lying, rng: rng.beta(...)`.
    """

    samples: Mapping[Key, Sequence[float] | np.ndarray]

    def __post_init__(self) -> None:
        for key, values in self.samples.items():
            array = np.asarray(values, dtype=np.float64)
            if not array.size or not ((array >= 0) & (array <= 1)).all():
                raise ValueError(f"samples of (size, liars) = {key} must be one or more similarities in [0, 1]")

    def __call__(self, group: Group, lying: Group, rng: np.random.Generator) -> float:
        """ValueError for a group of which nothing was measured."""
        values = _known(self.samples, (len(group), len(lying)))
        return float(values[int(rng.integers(len(values)))])


def _known(table: Mapping[Key, T], key: Key) -> T:
    if key not in table:
        raise ValueError(f"nothing is known of groups of {key[0]} with {key[1]} liars; add {key}, or pass a function")
    return table[key]


def _check_unit(name: str, value: float) -> float:
    if not 0 <= value <= 1:
        raise ValueError(f"{name} must be a probability in [0, 1], got {value}")
    return value
