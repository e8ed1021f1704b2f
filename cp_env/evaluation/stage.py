"""One cell, played: its scenes in lock-step, from reset to the last frame."""

from __future__ import annotations

import time
import zlib
from collections.abc import Callable, Sequence
from typing import Protocol as Interface
from typing import runtime_checkable

import numpy as np
from jaxtyping import Float
from torch import Tensor

import defenders
from cp_env.bank import SceneBank
from cp_env.evaluation.cells import Cell, Protocol, parse
from cp_env.evaluation.store import IOUS, Record
from cp_env.metrics import ApMeter
from cp_env.world import Outcome, Situation, World


@runtime_checkable
class Attacker(Interface):
    """What drives the liars of all worlds (see `agents.protocol`)."""

    def reset(self, n_worlds: int, rng: Sequence[np.random.Generator]) -> None: ...

    def act(self, situation: Situation) -> Float[Tensor, "E k C H W"]: ...


Clock = Callable[[], float]


def open_world(cell: Cell, protocol: Protocol, bank: SceneBank) -> World:
    """The cell's world, each scene reset with a seed of its own: the same liars for every defender and attack."""
    name, knobs = parse(cell.defender)
    world = World(
        len(cell.names), defender=defenders.make(name, **knobs), bank=bank, settings=protocol.settings(cell.k)
    )
    for e, scene in enumerate(cell.names):
        world.reset([_seed(cell.seed, scene, 0)], worlds=[e], options={"scene": scene})
    return world


def brief(attacker: Attacker, cell: Cell) -> None:
    """Reset the attacker, one stream of random numbers a scene."""
    streams = [np.random.default_rng(_seed(cell.seed, scene, 1)) for scene in cell.names]
    attacker.reset(len(cell.names), streams)


def play(
    cell: Cell, protocol: Protocol, bank: SceneBank, attacker: Attacker, clock: Clock = time.perf_counter
) -> list[Record]:
    """Play every scene of the cell to its end; one record a scene."""
    world = open_world(cell, protocol, bank)
    brief(attacker, cell)
    tapes = [_Tape(scene, tuple(liars)) for scene, liars in zip(cell.names, world.attackers.tolist(), strict=True)]
    while any(tape.running for tape in tapes):
        delta = attacker.act(world.situation())
        start = clock()
        outcome = world.step(delta)
        seconds = (clock() - start) / len(tapes)
        for e, tape in enumerate(tapes):
            tape.add(outcome, e, seconds)
    return [tape.record(protocol) for tape in tapes]


class _Tape:
    """One world's episode while it runs."""

    def __init__(self, scene: str, liars: tuple[int, ...]) -> None:
        self.scene, self.liars, self.running = scene, liars, True
        self.meter = ApMeter(IOUS)
        self.damage: list[float] = []
        self.similarity: list[float] = []
        self.verifications: list[int] = []
        self.suspects: tuple[int, ...] = ()
        self.converged: int | None = None
        self.error: str | None = None
        self.seconds = 0.0

    def add(self, outcome: Outcome, e: int, seconds: float) -> None:
        """Count one frame, unless the episode is over (the world waits for its neighbours then)."""
        if not self.running:
            return
        verdict = outcome.verdicts[e]
        self.meter.add(outcome.output[e].detections, outcome.truth[e])
        self.damage.append(round(float(outcome.damage[e]), 6))
        self.similarity.append(round(float(outcome.similarity[e]), 6))
        self.verifications.append(int(outcome.verifications[e]))
        if self.converged is None:
            self.suspects = tuple(sorted(verdict.suspects))
            self.converged = int(outcome.frame[e]) if verdict.converged else None
        self.error = outcome.errors[e]
        self.seconds += seconds
        self.running = not bool(outcome.truncated[e])

    def record(self, protocol: Protocol) -> Record:
        return Record(
            scene=self.scene,
            liars=self.liars,
            n_maps=protocol.n_vehicles + int(protocol.rsu),
            grace_frames=protocol.grace_frames,
            meter=self.meter,
            damage=tuple(self.damage),
            similarity=tuple(self.similarity),
            verifications=tuple(self.verifications),
            suspects=self.suspects,
            converged=self.converged,
            error=self.error,
            seconds=round(self.seconds, 6),
        )


def _seed(seed: int, scene: str, purpose: int) -> np.random.SeedSequence:
    """Depends on the seed and the scene only, so cells that differ in defender or attack are played in pairs."""
    return np.random.SeedSequence([seed, zlib.crc32(scene.encode()), purpose])
