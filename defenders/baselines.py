"""Defenders that bound the others: no defence, no collaboration, and the truth."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from defenders.protocol import Defender, Frame, Inspection, Verdict


class NoDefence(Defender):
    """Fuses everyone and asks nothing: what an attack costs when nobody defends."""

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        self.n_vehicles = n_vehicles

    def inspect(self, frame: Frame) -> Inspection:
        yield from ()
        return Verdict(range(self.n_vehicles))

    def belief(self) -> np.ndarray:
        return np.zeros(self.n_vehicles)


class EgoOnly(NoDefence):
    """Fuses the ego's own map alone and accuses nobody: what collaboration must beat. A lying ego is its downfall."""

    def inspect(self, frame: Frame) -> Inspection:
        yield from ()
        return Verdict({0})


class Oracle(NoDefence):
    """Told who lies, fuses the others, or the ego if none of them is present: the bound from above.

    The one exception to "nothing says who lies": a referee calls `tell`, where a defender has it, with the liars of the
    episode before every `reset`. Where the liars are fixed, the constructor may be told instead.
    """

    def __init__(self, *, liars: Collection[int] | None = None) -> None:
        self.liars: frozenset[int] | None = None if liars is None else frozenset(liars)

    def tell(self, liars: Collection[int]) -> None:
        """Hand over the truth about the coming episode."""
        self.liars = frozenset(int(i) for i in liars)

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        """ValueError if nobody told who lies, or if everyone or someone unknown is said to."""
        super().reset(n_vehicles, rng)
        if self.liars is None:
            raise ValueError("the oracle was not told who lies; pass liars= or let the referee call tell() first")
        if not self.liars < frozenset(range(n_vehicles)):
            raise ValueError(f"liars must be fewer than all {n_vehicles} vehicles, got {sorted(self.liars)}")

    def inspect(self, frame: Frame) -> Inspection:
        yield from ()
        assert self.liars is not None
        honest = frozenset(range(self.n_vehicles)) - self.liars
        fused = honest if honest & frame.present else frozenset({0})
        return Verdict(fused, self.liars - fused, True)

    def belief(self) -> np.ndarray:
        return np.array([float(i in (self.liars or ())) for i in range(self.n_vehicles)])
