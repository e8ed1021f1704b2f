"""The plan of an episode: drawn whole before anything changes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from cp_env.settings import Settings
from cp_env.world.reset import options_of, plan_episode, sequence_of
from cp_env.world.scene_cache import SceneBank
from cp_env.world.world import World


def test_a_plan_leaves_the_stream_as_it_was_and_holds_the_rest_of_it(bank: SceneBank) -> None:
    seeds = np.random.SeedSequence(5)
    first = plan_episode(bank, Settings(max_frames=3), seeds, {})
    again = plan_episode(bank, Settings(max_frames=3), seeds, {})
    assert seeds.n_children_spawned == 0 and first.seeds.n_children_spawned == 3
    assert (first.scene, first.start, first.attackers) == (again.scene, again.start, again.attackers)
    drawn = {plan_episode(bank, Settings(max_frames=3), np.random.SeedSequence(i), {}).attackers for i in range(30)}
    assert len(drawn) > 5


def test_worlds_may_have_options_of_their_own(bank: SceneBank) -> None:
    world = World(2, defender="none", bank=bank, max_frames=3)
    world.reset([1, 2], options=[{"scene": "toy-1", "start": 2}, {"scene": "toy-0"}])
    (first, start), (second, _) = world.places
    assert (first.scene.name, start, second.scene.name) == ("toy-1", 2, "toy-0")


def test_one_bad_world_leaves_all_as_they_were(bank: SceneBank) -> None:
    world = World(2, defender="none", bank=bank, max_frames=3)
    world.reset([1, 2])
    before = [(episode.scene.name, frame) for episode, frame in world.places], world.attackers.tolist()
    with pytest.raises(ValueError, match="start must be a frame"):
        world.reset([3, 4], options=[{"start": 0}, {"start": 77}])
    after = [(episode.scene.name, frame) for episode, frame in world.places], world.attackers.tolist()
    assert before == after


@pytest.mark.parametrize("options", ["scene", 3, [{}], [{}, 3], [{"strat": 1}, {}], {"strat": 1}])
def test_options_that_are_none(options: Any) -> None:
    with pytest.raises(ValueError, match=r"options|option of reset"):
        options_of(options, 2)


@pytest.mark.parametrize("seed", [-1, 0.5, True, "0", None])
def test_seeds_that_are_none(seed: Any) -> None:
    with pytest.raises(ValueError, match="a seed is a whole number"):
        sequence_of(seed)
