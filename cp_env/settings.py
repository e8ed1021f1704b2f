"""The options of one environment: their names, types and defaults stand here once, and are checked once."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypedDict, get_args, get_type_hints, no_type_check

import numpy as np

from defenders.registry import checked_value, shown, unknown

if TYPE_CHECKING:
    from cp_env.detector.protocol import DetectorLike
    from cp_env.types import SceneSource

Fusion = Literal["mean", "max", "sum", "v2vnet", "disconet"]
Norm = Literal["linf", "l2"]
Action = Literal["guided", "stealth", "critical", "basis", "full"]
ObservationKind = Literal["features", "compact"]
Knowledge = Literal["black-box", "gray-box", "white-box"]
RewardName = Literal["damage", "ap_drop", "stealth", "critical", "targeted"]
Slots = Literal["adversaries", "vehicles"]
Precision = Literal["float32", "bfloat16"]
StateKind = Literal["maps", "compact"]

FUSIONS: tuple[str, ...] = get_args(Fusion)
NORMS: tuple[str, ...] = get_args(Norm)
ACTIONS: tuple[str, ...] = get_args(Action)
OBSERVATIONS: tuple[str, ...] = get_args(ObservationKind)
KNOWLEDGE: tuple[str, ...] = get_args(Knowledge)
REWARDS: tuple[str, ...] = get_args(RewardName)
PRECISIONS: tuple[str, ...] = get_args(Precision)

LARGEST_FLEET = 1024
"""Vehicles of a scene, at most: far more than any data set has. Our choice."""

LARGEST_BUDGET = float(np.finfo(np.float16).max)
"""No map holds larger numbers: they are kept in half precision."""


def choose(what: str, value: str, known: Collection[str]) -> str:
    """`value` if it is one of `known`; else a ValueError that lists them and names the nearest."""
    if value not in known:
        raise unknown(what, value, known)
    return value


class Options(TypedDict, total=False):
    """The keywords of `cp_env.parallel_env` and of every other environment."""

    n_vehicles: int
    n_attackers: int
    attackers: Sequence[int] | None
    fusion: Fusion
    scenes: str | SceneSource
    action: Action
    observation: ObservationKind
    knowledge: Knowledge
    reward: RewardName | Callable[..., Any]
    budget: float
    norm: Norm
    gradient_precision: Precision | None
    rsu: bool
    slots: Slots
    grace_frames: int
    max_frames: int
    state: StateKind
    detector: str | DetectorLike
    checkpoint: str | Path | None
    device: str
    precision: Precision
    render_mode: str | None


WORLD_DEFAULTS: dict[str, Any] = {
    "scenes": "town",
    "detector": "cp_env",
    "checkpoint": None,
    "device": "cpu",
    "precision": "float32",
}
"""The options that say what is perceived and with what; all others are fields of `Settings`."""


@no_type_check  # by a run-time checker: what is wrong is told by the checks below
@dataclass(frozen=True, kw_only=True)
class Settings:
    """Everything `parallel_env` takes besides the defender, the scenes, the detector and the device.

    Raises:
        ValueError: a value of the wrong type or out of range, or a combination that cannot be played. The message names
            the rule, the value and the way out.
    """

    n_vehicles: int = 5
    n_attackers: int = 2
    attackers: Sequence[int] | None = None
    fusion: Fusion = "mean"
    action: Action = "guided"
    observation: ObservationKind = "features"
    knowledge: Knowledge = "black-box"
    reward: RewardName | Callable[..., Any] = "damage"
    budget: float = 0.3
    norm: Norm = "linf"
    gradient_precision: Precision | None = None
    rsu: bool = False
    slots: Slots = "adversaries"
    grace_frames: int = 1
    max_frames: int = 100
    state: StateKind = "maps"

    def __post_init__(self) -> None:
        for name, kind in _KINDS.items():
            object.__setattr__(self, name, checked_value(name, getattr(self, name), kind))
        if self.n_vehicles < 2 - self.rsu:
            unit = "1 with the road-side unit" if self.rsu else "an ego and a collaborator; 1 is enough with rsu=True"
            raise ValueError(f"n_vehicles must be at least {2 - self.rsu} ({unit}), not {self.n_vehicles}")
        if self.n_vehicles > LARGEST_FLEET:
            raise ValueError(f"n_vehicles must be at most {LARGEST_FLEET}, not {shown(self.n_vehicles)}")
        if not 0 <= self.budget <= LARGEST_BUDGET:
            raise ValueError(f"budget Δ must be a finite number from 0 to {LARGEST_BUDGET:.0f}, not {self.budget}")
        if self.max_frames < 1:
            raise ValueError(f"max_frames must be at least 1, not {self.max_frames}")
        if self.grace_frames < 0:
            raise ValueError(f"grace_frames must be at least 0, not {self.grace_frames}")
        if self.attackers is None:
            self._check_count()
        else:
            object.__setattr__(self, "attackers", _numbers(self.attackers, self.n_maps))
            self._check_set(self.attackers)

    @classmethod
    def of(cls, options: Mapping[str, Any]) -> Settings:
        """The settings with these options. ValueError, with the nearest known name, for an option that is none."""
        for name in options:
            if name not in _KINDS and name != "attackers":
                raise unknown("option", name, [*OPTION_NAMES])
        return cls(**options)

    def _check_count(self) -> None:
        if not 0 <= self.n_attackers < self.n_suspects:
            unit = " and the road-side unit" if self.n_suspects > self.n_vehicles else ""
            raise ValueError(
                f"n_attackers must satisfy 0 <= k < n: k = {self.n_attackers}, n_vehicles = {self.n_vehicles}{unit}; "
                "at least one vehicle must be benign"
            )

    def _check_set(self, attackers: Sequence[int]) -> None:
        wrong = [i for i in attackers if not 0 <= i < self.n_maps]
        if wrong or len(set(attackers)) != len(attackers):
            raise ValueError(
                f"attackers must be distinct numbers from 0 (the ego) to {self.n_maps - 1}, not {list(attackers)}"
            )
        if len(attackers) >= self.n_suspects:
            raise ValueError(
                f"attackers must leave one vehicle benign: {len(attackers)} of {self.n_suspects} are malicious"
            )

    @property
    def n_maps(self) -> int:
        """N: maps that can be fused, the road-side unit's included."""
        return self.n_vehicles + int(self.rsu)

    @property
    def n_suspects(self) -> int:
        """The numbers below this one are drawn as attackers: the vehicles, and the road-side unit beside one alone."""
        return max(self.n_vehicles, 2)

    @property
    def k(self) -> int:
        """Number of attackers."""
        return self.n_attackers if self.attackers is None else len(self.attackers)


def _numbers(attackers: object, n_maps: int) -> tuple[int, ...]:
    """Vehicle numbers from any sequence of whole numbers but a text; no more than there are maps."""
    listed = isinstance(attackers, Sequence | np.ndarray | set | frozenset) and not isinstance(attackers, str | bytes)
    if not listed or getattr(attackers, "ndim", 1) != 1:
        raise ValueError(f"attackers must be a sequence of vehicle numbers such as (0, 3), not {shown(attackers)}")
    assert isinstance(attackers, Sequence | np.ndarray | set | frozenset)
    if len(attackers) > n_maps:
        raise ValueError(f"attackers must be distinct numbers from 0 (the ego) to {n_maps - 1}, not {shown(attackers)}")
    return tuple(checked_value("attackers", number, int) for number in attackers)


_HINTS = get_type_hints(type("Hints", (), {"__annotations__": Settings.__annotations__}), globals())
_KINDS = {field.name: _HINTS[field.name] for field in fields(Settings) if field.name != "attackers"}

DEFAULTS: dict[str, Any] = {**vars(Settings()), **WORLD_DEFAULTS, "render_mode": None}
"""The default of every keyword of `cp_env.parallel_env` but the defender."""

OPTION_NAMES: tuple[str, ...] = tuple(Options.__annotations__)
"""The keywords of `cp_env.parallel_env`."""
