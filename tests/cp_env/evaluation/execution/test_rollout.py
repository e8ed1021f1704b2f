"""One cell: who lies, learned attackers through their own door, defenders that fail, and its film."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np

import agents
from cp_env.envs.core import Game
from cp_env.evaluation import Cell, Crew, Stage, Store, markdown, plan, play, run, summarise
from cp_env.evaluation.report.video import film
from tests.helpers.toy_evaluation import PROTOCOL, toy_bank


def test_the_seed_and_the_scene_decide_who_lies() -> None:
    def liars(defender: str, seed: int) -> list[list[int]]:
        cell = Cell(defender, "pgd", 2, seed, PROTOCOL.names)
        drawn: list[list[int]] = Stage(cell, PROTOCOL, toy_bank(), agents.make("none")).world.attackers.tolist()
        return drawn

    assert liars("none", 7) == liars("prbi", 7)
    everyone = [tuple(pair) for seed in range(20) for pair in liars("none", seed)]
    assert {i for pair in everyone for i in pair} == {0, 1, 2, 3, 4}  # the ego too
    assert any(first != second for first, second in zip(everyone[::2], everyone[1::2], strict=True))


class Habit:
    """A learned attacker, as the stage sees one: always the same action."""

    def __init__(self) -> None:
        self.knobs = {"action": "basis", "observation": "compact", "max_frames": 99}
        self.shapes: list[tuple[int, ...]] = []
        self.action = np.ones(Game(1, action="basis", bank=toy_bank()).single_action_space.shape, dtype=np.float32)

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        self.shapes.append(observations.shape)
        return np.broadcast_to(self.action, (*observations.shape[:2], *self.action.shape))


def test_a_learned_attacker_plays_through_its_own_action_map() -> None:
    cell, habit = Cell("none", "habit", 2, 7, PROTOCOL.names), Habit()
    ticks = itertools.count()
    records = play(cell, PROTOCOL, toy_bank(), habit, clock=lambda: float(next(ticks)))
    assert [r.seconds for r in records] == [PROTOCOL.frames / 2] * 2  # a tick a step, shared by two worlds
    assert [len(r.damage) for r in records] == [PROTOCOL.frames] * 2  # the protocol's frames, not the attacker's
    assert [shape[:2] for shape in habit.shapes] == [(2, 2)] * PROTOCOL.frames
    assert sum(sum(r.damage) for r in records) > 0
    scripted = play(cell, PROTOCOL, toy_bank(), agents.make("none"))
    assert [r.liars for r in scripted] == [r.liars for r in records]


def test_a_defender_that_fails_ends_its_episode_and_is_named(crew: Crew, tmp_path: Path) -> None:
    name = "tests.helpers.toy_evaluation:Grumpy"  # a class of one's own, by its place
    cells = plan(PROTOCOL, defenders=(name,), attacks=("none",), ks=(1,), seeds=(0,))
    list(run(cells, PROTOCOL, Store(tmp_path), crew))
    for record in Store(tmp_path).load(cells, PROTOCOL)[cells[0]]:
        assert len(record.damage) == 3
        assert record.error is not None
        assert "no more" in record.error
    (row,) = summarise(Store(tmp_path).load(cells, PROTOCOL), resamples=10)
    assert row.n_errors == 2
    assert "Grumpy (2 failed)" in markdown([row])


def test_a_film_has_a_picture_for_every_frame() -> None:
    cell = Cell("prbi", "pgd:steps=1", 2, 0, ("toy-1",))
    pictures = film(cell, PROTOCOL, toy_bank(), agents.make)
    assert len(pictures) == PROTOCOL.frames
    assert len(film(cell, PROTOCOL, toy_bank(), agents.make, frames=2)) == 2
    assert any((a != b).any() for a, b in itertools.pairwise(pictures))
