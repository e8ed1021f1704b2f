"""What a step says of itself, frame by frame: similarity, damage, expected collaborators, and the end of an episode."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from cp_env.metrics.similarity import jaccard, view_similarity
from cp_env.world.scene_cache import SceneBank
from cp_env.world.world import World
from defenders.protocol import Defender, Frame, Inspection, Verdict

FRAMES = 6
"""Frames of the toy crossings."""


class Excluding(Defender):
    """Leaves vehicle 4 out in every frame; converges in the frame `converges`."""

    def __init__(self, converges: int = 1) -> None:
        self.converges = converges

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        self.n = n_vehicles

    def inspect(self, frame: Frame) -> Inspection:
        yield from ()
        return Verdict(range(self.n - 1), {self.n - 1}, frame.index >= self.converges)


def made(bank: SceneBank, num_envs: int = 1, **options: Any) -> World:
    options = {"defender": Excluding(), "bank": bank, "max_frames": FRAMES, "grace_frames": 0, "budget": 3.0, **options}
    return World(num_envs, **options)


def loud(world: World, seed: int = 0) -> torch.Tensor:
    shape = (world.num_envs, world.settings.k, *world.current().received.shape[2:])
    return 9 * torch.randn(shape, generator=torch.Generator().manual_seed(seed))


def test_only_a_verdict_that_has_converged_changes_who_is_expected(bank: SceneBank) -> None:
    world = made(bank)
    world.reset([0])
    for frame in range(3):
        assert world.current().fused.tolist() == [[True, True, True, True, frame < 2]]
        assert world.excluded.tolist() == [[False, False, False, False, frame > 0]]
        world.step(loud(world))


def test_nothing_of_the_last_episode_is_left_after_a_reset(bank: SceneBank) -> None:
    world = made(bank, 2)
    world.reset([0, 1])
    for _ in range(3):
        world.step(loud(world))
    world.reset([5], [0])
    situation = world.current()
    assert situation.verdict[0] is situation.output[0] is None and situation.verdict[1] is not None
    assert situation.fused.tolist() == [[True] * 5, [True] * 4 + [False]]
    assert world.excluded.tolist() == [[False] * 5, [False] * 4 + [True]]
    assert situation.frame.tolist() == [0, 3]


def test_similarity_and_damage_are_those_of_the_views(bank: SceneBank) -> None:
    world = made(bank, 2, attackers=(1, 4))
    world.reset([0, 1])
    last: tuple[Any, ...] = (None, None)
    for frame in range(4):
        outcome = world.step(loud(world, frame))
        for e in range(2):
            expected = 1.0 if last[e] is None else view_similarity(outcome.seen[e], last[e])
            assert outcome.similarity[e] == pytest.approx(expected)
            kept = jaccard(outcome.output[e].seen.boxes, outcome.clean[e].seen.boxes)
            assert outcome.damage[e] == pytest.approx(1 - kept)
            assert outcome.output[e].group == frozenset(range(4)) < outcome.seen[e].group
        last = outcome.output


@pytest.mark.parametrize("start", range(FRAMES))
@pytest.mark.parametrize("max_frames", [1, 2, FRAMES, 9])
def test_an_episode_ends_with_its_time_or_its_scene_and_stays_there(
    bank: SceneBank, start: int, max_frames: int
) -> None:
    world = made(bank, max_frames=max_frames, defender="none")
    world.reset([0], options={"start": start})
    length = min(max_frames, FRAMES - start)
    ends, frames = [], []
    for _ in range(length + 2):
        outcome = world.step(torch.zeros_like(loud(world)))
        ends.append(bool(outcome.truncated[0]))
        frames.append(int(outcome.frame[0]))
        assert world.places[0][1] < FRAMES
    assert ends == [False] * (length - 1) + [True] * 3
    assert frames == [*range(length), length - 1, length - 1]
