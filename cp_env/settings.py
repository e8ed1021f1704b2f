"""The knobs of one environment, checked once at the outer door."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

FUSIONS = ("mean", "max", "sum", "v2vnet", "disconet")
NORMS = ("linf", "l2")
ACTIONS = ("guided", "quiet", "basis", "full")
OBSERVATIONS = ("features", "compact")
KNOWLEDGE = ("black-box", "gray-box", "white-box")
REWARDS = ("damage", "ap_drop", "stealth")
SLOTS = ("adversaries", "vehicles")


def choose(what: str, value: str, known: Sequence[str]) -> str:
    """`value` if it is one of `known`; else a ValueError that lists them."""
    if value not in known:
        raise ValueError(f"unknown {what} {value!r}: choose one of {', '.join(known)}")
    return value


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Everything `parallel_env` takes besides the defender and the scenes.

    Raises ValueError, naming the rule, the value and the way out, for a combination that cannot be played.
    """

    n_vehicles: int = 5
    n_attackers: int = 2
    attackers: Sequence[int] | None = None
    fusion: str = "mean"
    action: str = "guided"
    observation: str = "features"
    knowledge: str = "black-box"
    reward: str | Callable[..., Any] = "damage"
    budget: float = 0.3
    norm: str = "linf"
    rsu: bool = False
    slots: str = "adversaries"
    grace_frames: int = 1
    max_frames: int = 100

    def __post_init__(self) -> None:
        choose("fusion", self.fusion, FUSIONS)
        choose("action map", self.action, ACTIONS)
        choose("observation", self.observation, OBSERVATIONS)
        choose("knowledge", self.knowledge, KNOWLEDGE)
        if not callable(self.reward):
            choose("reward", self.reward, REWARDS)
        choose("norm", self.norm, NORMS)
        choose("slots", self.slots, SLOTS)
        if self.n_vehicles < 2:
            raise ValueError(f"n_vehicles must be at least 2 (an ego and a collaborator), not {self.n_vehicles}")
        if not (math.isfinite(self.budget) and self.budget >= 0):
            raise ValueError(f"budget Δ must be a finite number >= 0, not {self.budget}")
        if self.max_frames < 1:
            raise ValueError(f"max_frames must be at least 1, not {self.max_frames}")
        if self.grace_frames < 0:
            raise ValueError(f"grace_frames must be at least 0, not {self.grace_frames}")
        if self.attackers is None:
            self._check_count()
        else:
            object.__setattr__(self, "attackers", tuple(int(i) for i in self.attackers))  # any sequence will do
            self._check_set(self.attackers)

    def _check_count(self) -> None:
        if not 0 <= self.n_attackers < self.n_vehicles:
            raise ValueError(
                f"n_attackers must satisfy 0 <= k < n: k = {self.n_attackers}, n_vehicles = {self.n_vehicles}; "
                "at least one vehicle must be honest"
            )

    def _check_set(self, attackers: Sequence[int]) -> None:
        wrong = [i for i in attackers if not 0 <= i < self.n_maps]
        if wrong or len(set(attackers)) != len(attackers):
            raise ValueError(
                f"attackers must be distinct numbers from 0 (the ego) to {self.n_maps - 1}, not {list(attackers)}"
            )
        if len(attackers) >= self.n_vehicles:
            raise ValueError(f"attackers must leave one vehicle honest: {len(attackers)} of {self.n_vehicles} lie")

    @property
    def n_maps(self) -> int:
        """N: maps that can be fused, the road-side unit's included."""
        return self.n_vehicles + int(self.rsu)

    @property
    def k(self) -> int:
        """How many lie."""
        return self.n_attackers if self.attackers is None else len(self.attackers)
