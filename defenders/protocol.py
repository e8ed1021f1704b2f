"""What a defender is: it is shown a frame, asks for the views of groups of vehicles, and gives a verdict.

A defender *asks*; it never computes. `inspect` is a generator: it yields a `Query`, is sent the views, and returns a
`Verdict`. What must survive a frame lives on the object (which must pickle between frames); the rest is local names.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Generator, Iterable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

View = Any  # opaque: a defender never learns what a detection is


class QueryError(ValueError):
    """A defender asked for something that does not exist."""


@dataclass(frozen=True)
class Query:
    """Groups of vehicle numbers whose views are wanted; answered for all worlds in one forward.

    Each group counts as one verification, unless `verification` is False: that is for a reference the papers do not
    count (ROBOSAC's ego-only view). A group may lack the ego and may hold one vehicle; an empty one is an error. It is
    answered by those of it who are present (`Frame.present`), and is an error where none is.
    """

    groups: tuple[frozenset[int], ...]
    verification: bool = True

    def __init__(self, groups: Iterable[Iterable[int]], verification: bool = True) -> None:
        object.__setattr__(self, "groups", tuple(frozenset(map(int, group)) for group in groups))
        object.__setattr__(self, "verification", verification)


@dataclass(frozen=True)
class Verdict:
    """Who is fused for the output of this frame, as far as they are present, and who is accused now."""

    collaborators: frozenset[int]
    suspects: frozenset[int] = frozenset()
    converged: bool = False

    def __init__(self, collaborators: Iterable[int], suspects: Iterable[int] = (), converged: bool = False) -> None:
        object.__setattr__(self, "collaborators", frozenset(map(int, collaborators)))
        object.__setattr__(self, "suspects", frozenset(map(int, suspects)))
        object.__setattr__(self, "converged", bool(converged))


@runtime_checkable
class Frame(Protocol):
    """One frame as a defender sees it. Nothing in it says who lies."""

    @property
    def index(self) -> int:
        """Frames since the episode began; 0 is the first."""
        ...

    @property
    def n_vehicles(self) -> int:
        """Maps that can be fused: vehicle 0 is the ego; a road-side unit, if any, is the last."""
        ...

    @property
    def present(self) -> frozenset[int]:
        """Whose maps are there in this frame: everyone, unless a vehicle has yet to appear or has dropped out.

        The ego always is. Nothing is received from the others, so a group is answered by those of it who are present,
        and so is a verdict; a group or a verdict of none of them is a `QueryError`.
        """
        ...

    @property
    def seen(self) -> View:
        """The view with everyone fused who is present; free of charge."""
        ...

    def similarity(self, a: View, b: View) -> float:
        """Jaccard similarity of two views' boxes, PRBI Eq. (5), in [0, 1]; the ego's own motion is taken out first."""
        ...

    def agreement(self, a: View, b: View) -> float:
        """Consistency of two views' score maps, higher is more consistent, in [0, 0.5] (PASAC's CCLoss)."""
        ...


Inspection = Generator[Query, list[View], Verdict]


class Defender(ABC):
    """Base class of all defenders."""

    max_queries: int = 64
    """Queries a frame after which the referee fails the episode."""

    def configure(self, *, fusion: str) -> None:
        """How the ego fuses what it receives ("mean", "max", …), told by the referee before the first `reset`.

        It is the ego's own device, so whoever defends the ego knows it; similarities depend on it, and what is
        calibrated on them may. By default of no consequence.
        """
        del fusion

    @abstractmethod
    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        """Forget everything; a new episode with `n_vehicles` maps begins. All randomness must come from `rng`."""

    @abstractmethod
    def inspect(self, frame: Frame) -> Inspection:
        """Judge one frame. Yield queries, receive one view per group in order, return the verdict."""

    def belief(self) -> np.ndarray:
        """Probability that each vehicle lies, shape (n_vehicles,), for plots and white-box attackers; or empty."""
        return np.zeros(0)
