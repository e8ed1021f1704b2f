"""Defenders that bound the others: no defence, no collaboration, and the ground truth."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from defenders.protocol import Defender, Frame, Informed, Inspection, Verdict


class NoDefence(Defender):
    """No defence: fuses everyone and verifies nothing. It shows what an attack costs."""

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        self.n_vehicles = n_vehicles

    def inspect(self, frame: Frame) -> Inspection:
        yield from ()
        return Verdict(range(self.n_vehicles))

    def belief(self) -> np.ndarray:
        return np.zeros(self.n_vehicles)


class EgoOnly(NoDefence):
    """No collaboration: fuses the ego's own map alone and flags nobody. It fails if the ego is malicious."""

    def inspect(self, frame: Frame) -> Inspection:
        yield from ()
        return Verdict({0})


class Oracle(NoDefence, Informed):
    """Ground truth: fuses all benign vehicles, or the ego if none of them is present. The upper bound.

    It is the one exception to the rule that a defender does not know the attackers: it is `Informed`. Where the
    attackers are fixed, the constructor takes them instead.
    """

    def __init__(self, *, attackers: Collection[int] | None = None) -> None:
        self.attackers: frozenset[int] | None = None if attackers is None else frozenset(attackers)

    def reveal_attackers(self, attackers: frozenset[int]) -> None:
        """Take the attackers of the coming episode."""
        self.attackers = frozenset(int(i) for i in attackers)

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        """Begin an episode. ValueError if the attackers are not revealed, or are no proper subset of the vehicles."""
        super().reset(n_vehicles, rng)
        if self.attackers is None:
            raise ValueError(
                "the attackers were not revealed to the oracle; pass attackers= or have reveal_attackers() called first"
            )
        if not self.attackers < frozenset(range(n_vehicles)):
            raise ValueError(f"attackers must be fewer than all {n_vehicles} vehicles, got {sorted(self.attackers)}")

    def inspect(self, frame: Frame) -> Inspection:
        yield from ()
        assert self.attackers is not None
        benign = frozenset(range(self.n_vehicles)) - self.attackers
        fused = benign if benign & frame.present else frozenset({0})
        return Verdict(fused, self.attackers - fused, True)

    def belief(self) -> np.ndarray:
        return np.array([float(i in (self.attackers or ())) for i in range(self.n_vehicles)])
