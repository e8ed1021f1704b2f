"""The defender protocol: a defender is shown a frame, queries views of groups of vehicles, and returns a verdict.

A defender queries and never computes a view. `inspect` is a generator: it yields a `Query`, is sent the views, and
returns a `Verdict`. State that must survive a frame lives on the object, which must pickle between frames.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

View = Any  # opaque: a defender never reads detections


class QueryError(ValueError):
    """A query or verdict names vehicles that do not exist or are not present."""


@dataclass(frozen=True)
class Query:
    """Groups of vehicle numbers whose views are queried. The queries of all worlds are answered in one forward.

    Each group counts as one verification unless `verification` is False. That is for a reference which the papers do
    not count (ROBOSAC's ego-only view). A group may lack the ego and may hold one vehicle. An empty group is an error.
    It is answered by its present members (`Frame.present`), and is an error if there are none.
    """

    groups: tuple[frozenset[int], ...]
    verification: bool = True

    def __init__(self, groups: Iterable[Iterable[int]], verification: bool = True) -> None:
        object.__setattr__(self, "groups", tuple(frozenset(map(int, group)) for group in groups))
        object.__setattr__(self, "verification", verification)


@dataclass(frozen=True)
class Verdict:
    """Vehicles to fuse for the output of this frame, as far as present, and vehicles that are flagged now."""

    collaborators: frozenset[int]
    suspects: frozenset[int] = frozenset()
    converged: bool = False

    def __init__(self, collaborators: Iterable[int], suspects: Iterable[int] = (), converged: bool = False) -> None:
        object.__setattr__(self, "collaborators", frozenset(map(int, collaborators)))
        object.__setattr__(self, "suspects", frozenset(map(int, suspects)))
        object.__setattr__(self, "converged", bool(converged))


@runtime_checkable
class Frame(Protocol):
    """One frame as a defender sees it. Nothing in it identifies the attackers."""

    @property
    def index(self) -> int:
        """Frames since the episode began; 0 is the first."""
        ...

    @property
    def n_vehicles(self) -> int:
        """Number of maps that can be fused. Vehicle 0 is the ego; a road-side unit, if any, is the last."""
        ...

    @property
    def present(self) -> frozenset[int]:
        """Vehicles whose maps are received in this frame: all, unless one has yet to appear or has dropped out.

        The ego is always present. A group is answered by its present members, and so is a verdict. A group or verdict
        without a present vehicle is a `QueryError`.
        """
        ...

    @property
    def seen(self) -> View:
        """The full view: that of all present vehicles. It is no verification."""
        ...

    def similarity(self, a: View, b: View) -> float:
        """Jaccard similarity of two views' boxes, PRBI Eq. (5), in [0, 1], after compensation of the ego's motion."""
        ...

    def agreement(self, a: View, b: View) -> float:
        """Consistency of two views' score maps, in [0, 0.5]; higher is more consistent (PASAC's CCLoss)."""
        ...


Inspection = Generator[Query, list[View], Verdict]


class EgoFusion(str):
    """How the ego fuses, a text, with the digest of the detector that does it: what is calibrated is known by it."""

    __slots__ = ("detector",)

    detector: str | None

    def __new__(cls, fusion: str, detector: str | None = None) -> EgoFusion:
        """`detector`: the digest of its weights, the same in every episode; None if it is not known."""
        made = super().__new__(cls, fusion)
        made.detector = detector
        return made


class Defender(ABC):
    """Base class of all defenders."""

    max_queries: int = 64
    """Most queries in a frame. With more the referee fails the episode."""

    def configure(self, *, fusion: str) -> None:
        """Take the ego's fusion. The referee calls it before the first `reset`.

        The fusion is no secret, since it is the ego's own. Similarities depend on it, and so may whatever is calibrated
        on them. By default it has no effect.

        Args:
            fusion: How the ego fuses what it receives: "mean", "max", …. From the referee it is an `EgoFusion`.
        """
        del fusion

    @abstractmethod
    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        """Begin a new episode with `n_vehicles` maps and forget the last. All randomness must come from `rng`."""

    @abstractmethod
    def inspect(self, frame: Frame) -> Inspection:
        """Judge one frame: yield queries, receive one view for each group in order, and return the verdict."""

    def belief(self) -> np.ndarray:
        """Probability that each vehicle attacks, shape (n_vehicles,), for plots and white-box attacks; or empty."""
        return np.zeros(0)


class Informed(ABC):
    """A defender that is shown the ground truth, by deriving from this class: a bound, no defence.

    A method of the same name is not enough. The world records whom it informed, and no informed defender is ranked.
    """

    @abstractmethod
    def reveal_attackers(self, attackers: frozenset[int]) -> None:
        """Take the attackers of the coming episode. The world calls it before every `reset`."""


@runtime_checkable
class HasThreshold(Protocol):
    """A defender that compares similarities with a threshold ε: pictures show it."""

    @property
    def epsilon(self) -> float | Callable[[frozenset[int]], float]:
        """ε for every group, or a function of the group."""
        ...
