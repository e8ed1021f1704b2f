"""The rollout of one run: its scenes in lock-step, from reset to the last frame."""

from __future__ import annotations

import time
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float, Int

import defenders
from cp_env.attack import Attack, Learned
from cp_env.detector.coperception.truth import their_truth
from cp_env.envs.core import Game
from cp_env.evaluation.execution.driving_recorder import DrivingRecorder
from cp_env.evaluation.plan.records import IOUS, Record
from cp_env.evaluation.plan.runs import Conditions, Run
from cp_env.metrics.average_precision import ApMeter
from cp_env.world.episode import Episode
from cp_env.world.scene_cache import SceneBank
from cp_env.world.situation import FRAME_METRICS, Clock, Outcome
from cp_env.world.streams import keyed_generator
from cp_env.world.verification import DefenderError
from cp_env.world.world import World
from defenders.failure import Failure, blamed
from defenders.protocol import Defender
from defenders.sealed import seal

RECORDED = ("damage", "similarity", "verifications")
"""The frame metrics that a record holds."""

VIEWPOINT = ("action", "observation", "knowledge", "gradient_precision")
"""The options that a learned attack brings along; the rest is given by the conditions."""


class Rollout:
    """The worlds of a run: every scene is reset with a seed of its own, the same for every defender and attack.

    `world` holds the worlds, `step` plays one frame of them.
    """

    def __init__(
        self,
        run: Run,
        conditions: Conditions,
        bank: SceneBank,
        attack: Attack | Learned,
        clock: Clock = time.perf_counter,
    ) -> None:
        self._entries = f"defender {run.defender}", f"attack {run.attack}"
        with blamed(self._entries[0]):
            defender = seal(run.defender) if conditions.sealed else defenders.make(run.defender)
        settings = vars(conditions.settings(run.k))
        seeds = [_seed(run.seed, scene) for scene in run.names]
        options = [{"scene": scene} for scene in run.names]
        if isinstance(attack, Attack):
            self.world = World(
                len(run.names), defender=defender, bank=bank, clock=clock, key=conditions.key, **settings
            )
            with blamed(self._entries[0], DefenderError):
                self.world.reset(seeds, options=options)
            own = [keyed_generator(conditions.key, run.seed, scene, "attack") for scene in run.names]
            self.step = self._scripted(attack, own)
        else:
            settings = settings | {name: attack.options[name] for name in VIEWPOINT if name in attack.options}
            game = Game(len(run.names), defender, bank=bank, clock=clock, key=conditions.key, **settings)
            self.world = game.world
            with blamed(self._entries[0], DefenderError):
                observations, _ = game.reset(seeds, options=options)
            self.step = self._learned(attack, game, observations)

    def _scripted(self, attack: Attack, streams: list[np.random.Generator]) -> Callable[[], Outcome]:
        with blamed(self._entries[1]):
            attack.reset(len(streams), streams)

        def step() -> Outcome:
            situation = self.world.situation()
            with blamed(self._entries[1]):
                delta = attack.act(situation)
            return self.world.step(delta)

        return step

    def _learned(self, attack: Learned, game: Game, observations: Any) -> Callable[[], Outcome]:
        held = [observations]

        def step() -> Outcome:
            with blamed(self._entries[1]):
                actions = attack(held[0])
            held[0], *_ = game.step(actions)
            assert game.outcome is not None
            return game.outcome

        return step


def play(
    run: Run,
    conditions: Conditions,
    bank: SceneBank,
    attack: Attack | Learned,
    clock: Clock = time.perf_counter,
) -> list[Record]:
    """Play every scene of the run to its end.

    Args:
        run: what is played.
        conditions: under which it is played.
        bank: the encoded scenes.
        attack: scripted or learned.
        clock: measures the time of the world's steps.

    Returns:
        One record a scene.
    """
    rollout = Rollout(run, conditions, bank, attack, clock)
    attackers = rollout.world.attackers.tolist()
    recorders = [
        EpisodeRecorder(
            scene, tuple(numbers), conditions.ap, informed, rollout.world.settings.n_maps, finds_itself(rollout.world)
        )
        for scene, numbers, informed in zip(run.names, attackers, rollout.world.informed, strict=True)
    ]
    while any(recorder.running for recorder in recorders):
        places = rollout.world.places
        outcome = rollout.step()
        for e, recorder in enumerate(recorders):
            recorder.add(outcome, e, rollout.world.defenders[e], _witnesses(*places[e]) if recorder.running else None)
    return [recorder.record(conditions) for recorder in recorders]


def finds_itself(world: World) -> bool:
    """Whether the ego's own box is among its detections, as it is among coperception's."""
    return bool(getattr(world.detector, "all_boxes", False))


class EpisodeRecorder:
    """The record of one world's episode while it runs."""

    def __init__(
        self, scene: str, attackers: tuple[int, ...], ap: str, informed: bool, n_maps: int, finds_itself: bool = False
    ) -> None:
        self.scene, self.attackers, self.running = scene, attackers, True
        self.meter = ApMeter(IOUS, ap)
        self.metrics: dict[str, list[float]] = {name: [] for name in RECORDED}
        self.suspects: tuple[int, ...] = ()
        self.converged: int | None = None
        self.error: str | None = None
        self.failure: Failure | None = None
        self.informed, self.seconds = informed, 0.0
        self.driving, self._finds_itself = DrivingRecorder(n_maps), finds_itself

    def add(self, outcome: Outcome, e: int, defender: Defender, witnesses: Int[np.ndarray, " L"] | None = None) -> None:
        """Record one frame, unless the episode is over (the world waits for its neighbours then).

        Args:
            outcome: of all worlds.
            e: the episode's world.
            defender: of it.
            witnesses: how many single views find each true vehicle of the frame, where that is known.
        """
        if not self.running:
            return
        verdict = outcome.verdicts[e]
        self.meter.add(outcome.output[e].detections, self._truth(outcome, e))
        for name, values in self.metrics.items():
            values.append(round(float(FRAME_METRICS[name](outcome)[e]), 6))
        if self.converged is None:
            self.suspects = tuple(sorted(verdict.suspects))
            self.converged = int(outcome.frame[e]) if verdict.converged else None
        self.driving.add(outcome, e, defender, witnesses)
        self.error, self.failure = outcome.errors[e], outcome.judgements[e].failure
        self.seconds += outcome.seconds / len(outcome.judgements)
        self.running = not bool(outcome.truncated[e])

    def _truth(self, outcome: Outcome, e: int) -> Float[np.ndarray, "L 5"]:
        """The vehicles that the protocol counts: under coperception's the cars that their AP counts."""
        if self.meter.protocol != "coperception":
            return outcome.truth[e]
        scene, frame, extent = outcome.traffic[e]
        return their_truth(scene, frame, int(scene.connected[0]), extent, own=self._finds_itself)

    def record(self, conditions: Conditions) -> Record:
        return Record(
            scene=self.scene,
            attackers=self.attackers,
            n_maps=conditions.n_vehicles + int(conditions.rsu),
            grace_frames=conditions.grace_frames,
            meter=self.meter,
            damage=tuple(self.metrics["damage"]),
            similarity=tuple(self.metrics["similarity"]),
            verifications=tuple(map(int, self.metrics["verifications"])),
            suspects=self.suspects,
            converged=self.converged,
            error=self.error,
            informed=self.informed,
            seconds=round(self.seconds, 6),
            driving=self.driving.record(),
            critical_meter=self.driving.meter,
            failure=self.failure,
        )


def _witnesses(episode: Episode, frame: int) -> Int[np.ndarray, " L"] | None:
    """Of a frame of the unattacked scene, the same for all runs."""
    return None if episode.witnesses is None else episode.witnesses[frame]


def _seed(seed: int, scene: str) -> np.random.SeedSequence:
    """A seed that depends on seed and scene alone, so runs that differ in defender or attack are played in pairs."""
    return np.random.SeedSequence([seed, zlib.crc32(scene.encode())])
