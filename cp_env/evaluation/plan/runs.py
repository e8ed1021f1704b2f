"""Runs of an evaluation: the conditions common to all, and the plan."""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from typing import Any

from cp_env.metrics.average_precision import rules
from cp_env.scenes import open_source
from cp_env.settings import Fusion, Norm, Settings
from cp_env.types import SceneSource
from defenders.registry import Spec

NO_ATTACK = "none"
"""The absence of an attack: played once a defender, without attackers."""


@dataclass(frozen=True)
class Conditions:
    """The conditions that every run shares; part of every run's identity.

    Raises:
        ValueError: no scenes, unknown scenes, or an unknown AP protocol.
    """

    scenes: str | SceneSource  # a source of scenes
    names: tuple[str, ...]  # the scenes of it that are played
    frames: int = 100  # of an episode; it starts at a frame of the scene drawn from the seed
    n_vehicles: int = 5
    budget: float = 0.3
    norm: Norm = "linf"
    rsu: bool = False
    fusion: Fusion = "mean"
    grace_frames: int = 1
    ap: str = "strict"  # how average precision is counted: see `cp_env.metrics.average_precision`
    weights: str | None = None  # a file of the detector's; by default those that ship
    detector: str = "cp_env"  # see `cp_env.detector.registry`

    def __post_init__(self) -> None:
        rules(self.ap)
        if not self.names:
            raise ValueError("a benchmark needs at least one scene, got none")
        unknown = sorted(set(self.names) - set(open_source(self.scenes).names()))
        if unknown:
            raise ValueError(f"unknown scenes {unknown}; known: {', '.join(open_source(self.scenes).names())}")

    def settings(self, k: int) -> Settings:
        """The settings of a world with k attackers."""
        return Settings(
            n_vehicles=self.n_vehicles,
            n_attackers=k,
            fusion=self.fusion,
            budget=self.budget,
            norm=self.norm,
            rsu=self.rsu,
            grace_frames=self.grace_frames,
            max_frames=self.frames,
        )

    def describe(self) -> dict[str, Any]:
        """All conditions, fit for JSON."""
        scenes = self.scenes if isinstance(self.scenes, str) else self.scenes.name
        shared = {name: value for name, value in asdict(self.settings(0)).items() if name in self.__dataclass_fields__}
        ap = {} if self.ap == "strict" else {"ap": self.ap}  # the default leaves the names of stored runs as they were
        return {"scenes": scenes, "names": list(self.names), "frames": self.frames, **shared, **ap}


@dataclass(frozen=True)
class Run:
    """One defender against one attack with k attackers: some scenes in lock-step, one seed."""

    defender: str
    attack: str
    k: int
    seed: int
    names: tuple[str, ...]  # of the scenes

    def __str__(self) -> str:
        names = ", ".join(self.names)
        return f"{self.defender} against {self.attack}, k = {self.k}, seed {self.seed}, on {names}"

    def slug(self, conditions: Conditions, detector: str = "") -> str:
        """A file name: readable, and distinct for any other run, conditions, scene source or detector digest.

        A run with a class of yours is another one, too, when the file that holds the class was changed.
        """
        described = {**conditions.describe(), "names": None, "digest": open_source(conditions.scenes).digest}
        custom_classes = [code for spec in (self.defender, self.attack) if (code := code_of(spec)) is not None]
        identity = zlib.crc32(repr((self, detector, sorted(described.items()), *custom_classes)).encode())
        words = file_words(f"{self.defender}-{self.attack}")
        return f"{words}-k{self.k}-s{self.seed}-{self.names[0]}-{identity:08x}"


def plan_runs(
    conditions: Conditions,
    *,
    defenders: Sequence[str],
    attacks: Sequence[str],
    ks: Sequence[int],
    seeds: Sequence[int],
    batch: int = 4,
) -> list[Run]:
    """Every run, `batch` scenes each. The attack "none" is played without attackers, once whatever `ks` says.

    Args:
        conditions: that every run shares.
        defenders: specs.
        attacks: specs.
        ks: numbers of attackers.
        seeds: of starts, attackers and noise.
        batch: scenes in lock-step.

    Returns:
        The runs.

    Raises:
        ValueError: a k that the conditions do not allow, a spec that cannot be read, or an empty or doubled axis.
    """
    for what, values in (("defenders", defenders), ("attacks", attacks), ("ks", ks), ("seeds", seeds)):
        if not values or len(set(values)) != len(values):
            raise ValueError(f"{what} must be distinct, and at least one; got {list(values)}")
    for spec in (*defenders, *attacks):
        Spec.parse(spec)
    for k in ks:
        if k < 1:
            raise ValueError(f"ks counts attackers and must be at least 1, not {k}; none is the attack {NO_ATTACK!r}")
        conditions.settings(k)
    if batch < 1:
        raise ValueError(f"batch must be at least 1 scene, not {batch}")
    games = [(attack, k) for attack in attacks for k in ((0,) if attack == NO_ATTACK else ks)]
    return [
        Run(defender, attack, k, seed, names)
        for seed, names in product(seeds, _chunks(conditions.names, batch))
        for (attack, k), defender in product(games, defenders)
    ]


@lru_cache
def code_of(spec: str) -> int | None:
    """Checksum of the file that holds a class of yours; None for known names, and for classes without a file."""
    place = Spec.parse(spec).place
    try:
        found = find_spec(place[0]) if place else None
    except (ImportError, ValueError):
        return None
    file = Path(found.origin) if found and found.has_location and found.origin else None
    return zlib.crc32(file.read_bytes()) if file and file.is_file() else None


def file_words(words: str) -> str:
    """Text fit for a file name."""
    return "".join(c if c.isalnum() or c in "-_[]()+" else "_" for c in words)[:120]


def _chunks(names: tuple[str, ...], size: int) -> Iterator[tuple[str, ...]]:
    for start in range(0, len(names), size):
        yield names[start : start + size]
