"""One cell, played: its scenes in lock-step, from reset to the last frame."""

from __future__ import annotations

import time
import zlib
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import numpy as np
from jaxtyping import Float
from torch import Tensor

import defenders
from cp_env.attack import Attacker, Learned
from cp_env.envs.core import Game
from cp_env.evaluation.plan.records import IOUS, Record
from cp_env.evaluation.plan.runs import Cell, Protocol, parse
from cp_env.metrics.average_precision import ApMeter
from cp_env.world.scene_cache import SceneBank
from cp_env.world.situation import Outcome
from cp_env.world.world import World
from defenders.protocol import Defender

VIEWPOINT = ("action", "observation", "knowledge")
"""The knobs a learned attacker brings along; the rest is the protocol's."""


Clock = Callable[[], float]


class Stage:
    """A cell set up: every scene is reset with a seed of its own, the same for every defender and attack.

    `world` is what is played, `move` plays one frame of it, `seconds` is what the world's steps took so far: perceiving
    and defending, not attacking.
    """

    def __init__(
        self,
        cell: Cell,
        protocol: Protocol,
        bank: SceneBank,
        attacker: Attacker | Learned,
        clock: Clock = time.perf_counter,
    ) -> None:
        defender = open_defender(cell.defender)
        settings = asdict(protocol.settings(cell.k))
        self.seconds = 0.0
        if isinstance(attacker, Attacker):
            self.world = World(len(cell.names), defender=defender, bank=bank, **settings)
            _reset(self.world, cell)
            self.move = self._scripted(attacker, [np.random.default_rng(_seed(cell.seed, s, 1)) for s in cell.names])
        else:
            settings |= {knob: attacker.knobs[knob] for knob in VIEWPOINT if knob in attacker.knobs}
            game = Game(len(cell.names), defender, bank=bank, **settings)
            self.world = game.world
            self.move = self._learned(attacker, game, _reset(game, cell))
        self._time(clock)

    def _scripted(self, attacker: Attacker, streams: list[np.random.Generator]) -> Callable[[], Outcome]:
        attacker.reset(len(streams), streams)
        return lambda: self.world.step(attacker.act(self.world.situation()))

    def _learned(self, attacker: Learned, game: Game, observations: Any) -> Callable[[], Outcome]:
        held = [observations]

        def move() -> Outcome:
            held[0], *_ = game.step(attacker(held[0]))
            assert game.outcome is not None
            return game.outcome

        return move

    def _time(self, clock: Clock) -> None:
        """Let a stopwatch run during the steps of this world, whoever calls them."""
        step = self.world.step

        def timed(delta: Float[Tensor, "E k C H W"]) -> Outcome:
            start = clock()
            outcome = step(delta)
            self.seconds += clock() - start
            return outcome

        self.world.step = timed  # type: ignore[method-assign]


def open_defender(spec: str) -> Defender:
    """The defender a spec names: one of `defenders.names()`, or a class of yours as `module:Class`.

    Raises ValueError for an unknown name, a class that cannot be imported, and knobs it has not.
    """
    name, knobs = parse(spec)
    return defenders.make(name, **knobs)


def play(
    cell: Cell,
    protocol: Protocol,
    bank: SceneBank,
    attacker: Attacker | Learned,
    clock: Clock = time.perf_counter,
) -> list[Record]:
    """Play every scene of the cell to its end; one record a scene."""
    stage = Stage(cell, protocol, bank, attacker, clock)
    liars = stage.world.attackers.tolist()
    tapes = [_Tape(scene, tuple(numbers), protocol.ap) for scene, numbers in zip(cell.names, liars, strict=True)]
    while any(tape.running for tape in tapes):
        before = stage.seconds
        outcome = stage.move()
        for e, tape in enumerate(tapes):
            tape.add(outcome, e, (stage.seconds - before) / len(tapes))
    return [tape.record(protocol) for tape in tapes]


def _reset(worlds: World | Game, cell: Cell) -> Any:
    """Begin every world on its scene; a game's observations."""
    seeds = [_seed(cell.seed, scene, 0) for scene in cell.names]
    worlds.reset(seeds, options={"scene": cell.names[0]})  # a game observes all of its worlds at once
    result = None
    for e, (scene, seed) in enumerate(zip(cell.names, seeds, strict=True)):
        fresh = np.random.SeedSequence(seed.entropy)  # spawning leaves its trace on a sequence
        result = worlds.reset([fresh], worlds=[e], options={"scene": scene})
    return result[0] if result else None


class _Tape:
    """One world's episode while it runs."""

    def __init__(self, scene: str, liars: tuple[int, ...], ap: str) -> None:
        self.scene, self.liars, self.running = scene, liars, True
        self.meter = ApMeter(IOUS, ap)
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
