"""The plan of an episode: drawn whole before anything changes."""

from __future__ import annotations

from typing import Any

import pytest

from cp_env.settings import Settings
from cp_env.world.reset import options_of, plan_episode
from cp_env.world.scene_cache import SceneBank
from cp_env.world.streams import Stream
from cp_env.world.world import World


def test_a_plan_leaves_the_stream_as_it_was_and_holds_the_rest_of_it(bank: SceneBank) -> None:
    stream = Stream.of(5)
    first, again = (plan_episode(bank, Settings(max_frames=3), stream, {}) for _ in range(2))
    assert stream.episode == 0 and first.stream.episode == 1
    assert (first.scene, first.start, first.attackers) == (again.scene, again.start, again.attackers)
    assert first.rng.bit_generator.state == again.rng.bit_generator.state
    drawn = {plan_episode(bank, Settings(max_frames=3), Stream.of(i), {}).attackers for i in range(30)}
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


@pytest.mark.parametrize("options", ["scene", 3, [{}], [{}, 3], [{"strat": 1}, {}], {"strat": 1}, range(10**9)])
def test_options_that_are_none(options: Any) -> None:
    with pytest.raises(ValueError, match=r"options|option of reset"):
        options_of(options, 2)
