"""Runs of an evaluation: the conditions common to all, and the plan."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from itertools import product
from typing import Any

from cp_env.evaluation.plan.sources import calibration_digest, code_of
from cp_env.metrics.average_precision import rules
from cp_env.scenes import open_source
from cp_env.settings import Fusion, Norm, Precision, Settings
from cp_env.types import SceneSource
from cp_env.world.streams import PUBLIC_KEY, name_of_key
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
    precision: Precision = "float32"  # of the detector's maps, fusion and decoder
    sealed: bool = False  # each defender runs in a process of its own: see `defenders.sealed`
    key: str = field(default=PUBLIC_KEY, repr=False)  # of all random streams: see `cp_env.world.streams`

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
        sealed = {"sealed": True} if self.sealed else {}
        key = {} if self.key == PUBLIC_KEY else {"key": name_of_key(self.key)}
        return {"scenes": scenes, "names": list(self.names), "frames": self.frames, **shared, **ap, **sealed, **key}


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

    def identity(self, conditions: Conditions, detector: str = "") -> dict[str, str]:
        """All that the results depend on beyond the run's own fields, fit for JSON.

        Args:
            conditions: under which the run is played.
            detector: digest of the detector's weights.

        Returns:
            The package's version; digests of the scenes, of the weights, of the user's calibration of them if there is
            one, and of the source files of the defender, the attack and the detector (see `sources.code_of`).
        """
        own = calibration_digest(detector)  # what ships counts with the defender's files
        return {
            "version": _version(),
            "scenes": open_source(conditions.scenes).digest,
            "weights": detector,
            "defender_code": code_of("defender", self.defender),
            "attack_code": code_of("attack", self.attack),
            "detector_code": code_of("detector", conditions.detector),
            **({"calibration": own} if own else {}),
        }

    def slug(self, conditions: Conditions, detector: str = "") -> str:
        """A file name: readable, and distinct for any other run, conditions or `identity`."""
        described = {**conditions.describe(), "names": None, "detector": conditions.detector}
        said = (self, sorted(described.items()), sorted(self.identity(conditions, detector).items()))
        digest = hashlib.sha256(repr(said).encode()).hexdigest()[:16]
        words = file_words(f"{self.defender}-{self.attack}")
        return f"{words}-k{self.k}-s{self.seed}-{file_words(self.names[0])[:40]}-{digest}"


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


def _version() -> str:
    """Of the package that this module is in; it is loaded, and stands above this floor."""
    return str(sys.modules[__name__.partition(".")[0]].__version__)


def file_words(words: str) -> str:
    """Text fit for a file name: at most 120 letters, digits and signs that every file system takes."""
    return "".join(c if (c.isascii() and c.isalnum()) or c in "-_[]()+" else "_" for c in words)[:120]


def _chunks(names: tuple[str, ...], size: int) -> Iterator[tuple[str, ...]]:
    for start in range(0, len(names), size):
        yield names[start : start + size]
