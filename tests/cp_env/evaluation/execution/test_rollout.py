"""The rollout of one run: its attackers, learned attacks, defenders that fail, and its video."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np

import agents
from cp_env.detector.coperception.truth import their_truth
from cp_env.envs.core import Game
from cp_env.evaluation import Rollout, Run, Store, Workers, execute, markdown, plan_runs, play, summarise
from cp_env.evaluation.execution.rollout import EpisodeRecorder, finds_itself
from tests.helpers.toy_evaluation import CONDITIONS, toy_bank


def test_the_seed_and_the_scene_decide_the_attackers() -> None:
    def attackers(defender: str, seed: int) -> list[list[int]]:
        run = Run(defender, "pgd", 2, seed, CONDITIONS.names)
        drawn: list[list[int]] = Rollout(run, CONDITIONS, toy_bank(), agents.make("none")).world.attackers.tolist()
        return drawn

    assert attackers("none", 7) == attackers("prbi", 7)
    everyone = [tuple(pair) for seed in range(20) for pair in attackers("none", seed)]
    assert {i for pair in everyone for i in pair} == {0, 1, 2, 3, 4}  # the ego too
    assert any(first != second for first, second in zip(everyone[::2], everyone[1::2], strict=True))


class Habit:
    """A learned attack: always the same action."""

    def __init__(self) -> None:
        self.options = {"action": "basis", "observation": "compact", "max_frames": 99}
        self.shapes: list[tuple[int, ...]] = []
        self.action = np.ones(Game(1, action="basis", bank=toy_bank()).single_action_space.shape, dtype=np.float32)

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        self.shapes.append(observations.shape)
        return np.broadcast_to(self.action, (*observations.shape[:2], *self.action.shape))


def test_a_learned_attack_plays_through_its_own_action_map() -> None:
    run, habit = Run("none", "habit", 2, 7, CONDITIONS.names), Habit()
    ticks = itertools.count()
    records = play(run, CONDITIONS, toy_bank(), habit, clock=lambda: float(next(ticks)))
    assert [r.seconds for r in records] == [CONDITIONS.frames / 2] * 2  # a tick a step, shared by two worlds
    assert [len(r.damage) for r in records] == [CONDITIONS.frames] * 2  # the conditions' frames, not the attack's
    assert [shape[:2] for shape in habit.shapes] == [(2, 2)] * CONDITIONS.frames
    assert sum(sum(r.damage) for r in records) > 0
    scripted = play(run, CONDITIONS, toy_bank(), agents.make("none"))
    assert [r.attackers for r in scripted] == [r.attackers for r in records]


def test_a_defender_that_fails_ends_its_episode_and_is_named(workers: Workers, tmp_path: Path) -> None:
    name = "tests.helpers.toy_evaluation:Grumpy"  # a class of one's own, by its place
    runs = plan_runs(CONDITIONS, defenders=(name,), attacks=("none",), ks=(1,), seeds=(0,))
    list(execute(runs, CONDITIONS, Store(tmp_path), workers))
    for record in Store(tmp_path).load(runs, CONDITIONS)[runs[0]]:
        assert len(record.damage) == 3
        assert record.error is not None
        assert "no more" in record.error
    (row,) = summarise(Store(tmp_path).load(runs, CONDITIONS), resamples=10)
    assert row.n_errors == 2
    assert "Grumpy (2 failed)" in markdown([row])


def test_under_coperceptions_protocol_their_cars_count() -> None:
    """The ego's own among them only for a detector that finds it."""
    conditions = replace(CONDITIONS, ap="coperception")
    run = Run("none", "none", 1, 7, CONDITIONS.names)
    rollout = Rollout(run, conditions, toy_bank(), agents.make("none"))
    (episode, t), outcome = rollout.world.places[0], rollout.step()
    ego = int(episode.scene.connected[0])
    assert not finds_itself(rollout.world)
    counted = {
        own: EpisodeRecorder("toy", (1,), "coperception", False, 5, own)._truth(outcome, 0) for own in (False, True)
    }
    for own, boxes in counted.items():
        assert np.array_equal(boxes, their_truth(episode.scene, t, ego, own=own))
    assert len(counted[True]) == len(counted[False]) + 1
    assert np.array_equal(EpisodeRecorder("toy", (1,), "strict", False, 5)._truth(outcome, 0), outcome.truth[0])
