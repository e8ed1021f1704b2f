"""The single-agent view: the parallel one joined; gymnasium's and Stable-Baselines3's checks pass without a warning."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
import stable_baselines3.common.env_checker as sb3
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env

import cp_env
from cp_env.envs.parallel import CollaborativePerceptionEnv
from cp_env.envs.single import JointAdversaryEnv
from cp_env.world.scene_cache import SceneBank
from tests.cp_env.conftest import FRAMES

Make = Callable[..., CollaborativePerceptionEnv]


@pytest.fixture
def make(bank: SceneBank) -> Callable[..., gymnasium.Env[Any, Any]]:
    """By its registered id: gymnasium's checker makes further ones from the spec."""

    def make(**options: Any) -> gymnasium.Env[Any, Any]:
        return gymnasium.make(cp_env.ENV_ID, bank=bank, **{"max_frames": FRAMES, **options})

    return make


@pytest.mark.parametrize("action", ["guided", "basis", "full"])
def test_gymnasiums_check(make: Any, action: str) -> None:
    check_env(make(action=action, render_mode="rgb_array").unwrapped)


def test_gymnasiums_check_of_feature_maps(make: Any) -> None:
    check_env(make(observation="features", render_mode="rgb_array").unwrapped)


def test_attackers_may_be_fixed_by_any_sequence(make: Any) -> None:
    for attackers in ([1, 3], (1, 3), range(1, 4, 2)):
        _, info = make(attackers=attackers).reset(seed=0)
        assert info["vehicle"].tolist() == [1, 3]


@pytest.mark.parametrize("action", ["guided", "basis"])
@pytest.mark.parametrize("knowledge", ["black-box", "white-box"])
def test_stable_baselines_check(make: Any, action: str, knowledge: str) -> None:
    sb3.check_env(make(action=action, knowledge=knowledge).unwrapped)


@pytest.mark.filterwarnings("ignore:It seems that your observation", "ignore:The minimal resolution for an image")
def test_stable_baselines_takes_feature_maps_for_images(make: Any) -> None:
    """Three axes are an image to it, whatever they hold: the default observation is therefore the compact one."""
    sb3.check_env(make(observation="features").unwrapped)


def test_it_is_the_parallel_environment_laid_end_to_end(make: Any, toy_env: Make) -> None:
    single = make(action="guided").unwrapped
    many = toy_env(action="guided", observation="compact")
    observation, info = single.reset(seed=4)
    observations, infos = many.reset(seed=4)
    rng = np.random.default_rng(0)
    for frame in range(FRAMES + 1):
        assert np.array_equal(observation, np.concatenate(list(observations.values())))
        for key, values in info.items():
            assert values.tolist() == [infos[agent][key] for agent in many.possible_agents]
        if frame < FRAMES:
            actions = {agent: rng.uniform(-1, 1, 8).astype(np.float32) for agent in many.agents}
            observation, reward, terminated, truncated, info = single.step(np.concatenate(list(actions.values())))
            observations, rewards, _, truncations, infos = many.step(actions)
            assert (reward, terminated, truncated) == (rewards["adversary_0"], False, all(truncations.values()))
    assert truncated


def test_spaces_are_as_many_slots_wide(make: Any) -> None:
    assert make(action="guided").action_space.shape == (2 * 8,)
    assert make(action="full").action_space.shape == (2 * 8, 32, 32)
    features = make(observation="features", n_attackers=3).observation_space
    assert features["features"].shape == (3 * 8, 32, 32)


def test_bad_actions_are_refused(make: Any) -> None:
    env = make().unwrapped
    with pytest.raises(ResetNeeded, match=r"call reset\(\)"):
        env.step(env.action_space.sample())
    env.reset()
    with pytest.raises(ValueError, match=r"must have shape \(16,\), got \(15,\)"):
        env.step(np.zeros(15, np.float32))
    with pytest.raises(ValueError, match="NaN"):
        env.step(np.full(16, np.nan, np.float32))
    for _ in range(FRAMES):
        env.step(env.action_space.sample())
    with pytest.raises(ResetNeeded, match=r"call reset\(\)"):
        env.step(env.action_space.sample())


def test_repr_shows_the_options(bank: SceneBank) -> None:
    shown = repr(JointAdversaryEnv("robosac", bank=bank, n_attackers=1, max_frames=2))
    assert shown.startswith("JointAdversaryEnv(defender='robosac', scenes='toy', ")
    assert "n_attackers=1, " in shown and "max_frames=2, " in shown and shown.endswith("render_mode=None)")
