"""What is to be played: the conditions common to all, and the cells of the table."""

from __future__ import annotations

import ast
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
from cp_env.settings import Settings
from cp_env.types import SceneSource

NOBODY = "none"
"""The attack of nobody: played once a defender, with no liars."""


@dataclass(frozen=True)
class Protocol:
    """The conditions every cell shares; part of every cell's identity."""

    scenes: str | SceneSource  # a source of scenes
    names: tuple[str, ...]  # the scenes of it that are played
    frames: int = 100  # of an episode; it starts at a frame of the scene drawn from the seed
    n_vehicles: int = 5
    budget: float = 0.3
    norm: str = "linf"
    rsu: bool = False
    fusion: str = "mean"
    grace_frames: int = 1
    ap: str = "strict"  # how average precision is counted: see `cp_env.metrics.average_precision`
    weights: str | None = None  # a file of the detector's; by default those that ship

    def __post_init__(self) -> None:
        rules(self.ap)
        if not self.names:
            raise ValueError("a benchmark needs at least one scene, got none")
        unknown = sorted(set(self.names) - set(open_source(self.scenes).names()))
        if unknown:
            raise ValueError(f"unknown scenes {unknown}; known: {', '.join(open_source(self.scenes).names())}")

    def settings(self, k: int) -> Settings:
        """The knobs of a world in which k vehicles lie."""
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
        """All of it, fit for JSON."""
        scenes = self.scenes if isinstance(self.scenes, str) else self.scenes.name
        shared = {name: value for name, value in asdict(self.settings(0)).items() if name in self.__dataclass_fields__}
        ap = {} if self.ap == "strict" else {"ap": self.ap}  # the default leaves the names of stored cells as they were
        return {"scenes": scenes, "names": list(self.names), "frames": self.frames, **shared, **ap}


@dataclass(frozen=True)
class Cell:
    """One defender against one attack with k liars: some scenes in lock-step, one seed."""

    defender: str
    attack: str
    k: int
    seed: int
    names: tuple[str, ...]  # of the scenes

    def __str__(self) -> str:
        names = ", ".join(self.names)
        return f"{self.defender} against {self.attack}, k = {self.k}, seed {self.seed}, on {names}"

    def slug(self, protocol: Protocol, detector: str = "") -> str:
        """A file name: readable, and distinct for any other cell, protocol, scene source or detector digest.

        An outsider's cell is another one, too, when the file that holds its class was changed.
        """
        conditions = {**protocol.describe(), "names": None, "digest": open_source(protocol.scenes).digest}
        outsiders = [code for spec in (self.defender, self.attack) if (code := code_of(spec)) is not None]
        identity = zlib.crc32(repr((self, detector, sorted(conditions.items()), *outsiders)).encode())
        words = file_words(f"{self.defender}-{self.attack}")
        return f"{words}-k{self.k}-s{self.seed}-{self.names[0]}-{identity:08x}"


def plan(
    protocol: Protocol,
    *,
    defenders: Sequence[str],
    attacks: Sequence[str],
    ks: Sequence[int],
    seeds: Sequence[int],
    batch: int = 4,
) -> list[Cell]:
    """Every cell, `batch` scenes each. The attack "none" is played without liars, once whatever `ks` says.

    Raises ValueError for a k the protocol does not allow, a spec that cannot be read, and an empty or doubled axis.
    """
    for what, values in (("defenders", defenders), ("attacks", attacks), ("ks", ks), ("seeds", seeds)):
        if not values or len(set(values)) != len(values):
            raise ValueError(f"{what} must be distinct, and at least one; got {list(values)}")
    for spec in (*defenders, *attacks):
        parse(spec)
    for k in ks:
        if k < 1:
            raise ValueError(f"ks counts liars and must be at least 1, not {k}; no liars is the attack {NOBODY!r}")
        protocol.settings(k)
    if batch < 1:
        raise ValueError(f"batch must be at least 1 scene, not {batch}")
    games = [(attack, k) for attack in attacks for k in ((0,) if attack == NOBODY else ks)]
    return [
        Cell(defender, attack, k, seed, names)
        for seed, names in product(seeds, _chunks(protocol.names, batch))
        for (attack, k), defender in product(games, defenders)
    ]


def parse(spec: str) -> tuple[str, dict[str, Any]]:
    """Name and knobs: `"prbi:threshold=calibrated,window=5"` is "prbi", {"threshold": "calibrated", "window": 5}.

    The name may be where an outsider's class is: `"module:Class:knob=value"` is "module:Class", {"knob": "value"}.
    """
    name, _, rest = spec.partition(":")
    attribute, _, behind = rest.partition(":")
    if attribute.isidentifier():
        name, rest = f"{name}:{attribute}", behind
    knobs: dict[str, Any] = {}
    for part in filter(None, rest.split(",")):
        key, equals, value = part.partition("=")
        if not (name and equals and key.isidentifier()):
            raise ValueError(
                f"cannot read {spec!r}: write name, module:Class, or either with knobs: name:knob=value,knob=value"
            )
        try:
            knobs[key] = ast.literal_eval(value)
        except (ValueError, SyntaxError):
            knobs[key] = value
    return name, knobs


def outsider(name: str) -> tuple[str, str] | None:
    """Module and attribute, if the name says where a class is ("module:Class", "package.module.Class")."""
    module, _, attribute = name.replace(":", ".").rpartition(".")
    return (module, attribute) if module else None


@lru_cache
def code_of(spec: str) -> int | None:
    """Checksum of the file that holds an outsider's class; None for those that are known by name, or have no file."""
    place = outsider(parse(spec)[0])
    try:
        found = find_spec(place[0]) if place else None
    except (ImportError, ValueError):
        return None
    file = Path(found.origin) if found and found.has_location and found.origin else None
    return zlib.crc32(file.read_bytes()) if file and file.is_file() else None


def file_words(words: str) -> str:
    """Fit for the name of a file."""
    return "".join(c if c.isalnum() or c in "-_[]()+" else "_" for c in words)[:120]


def _chunks(names: tuple[str, ...], size: int) -> Iterator[tuple[str, ...]]:
    for start in range(0, len(names), size):
        yield names[start : start + size]
