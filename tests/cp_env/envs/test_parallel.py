"""PettingZoo's own tests pass without a warning, and the agents are what the environment promises."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from pettingzoo.test import api_test, max_cycles_test, parallel_api_test, parallel_seed_test, render_test, seed_test
from pettingzoo.utils.conversions import parallel_to_aec

from cp_env.envs.parallel import CollaborativePerceptionEnv
from cp_env.testing import check_env
from tests.cp_env.conftest import FRAMES

Make = Callable[..., CollaborativePerceptionEnv]


@pytest.mark.parametrize("observation", ["features", "compact"])
def test_parallel_api(toy_env: Make, observation: str) -> None:
    parallel_api_test(toy_env(observation=observation), num_cycles=2 * FRAMES)
    parallel_api_test(toy_env(observation=observation), num_cycles=FRAMES - 1)


def test_parallel_seed(toy_env: Make) -> None:
    parallel_seed_test(toy_env, num_cycles=FRAMES)


def test_aec_api(toy_env: Make) -> None:
    api_test(parallel_to_aec(toy_env(observation="compact")), num_cycles=2 * FRAMES)


@pytest.mark.filterwarnings(  # said of every Dict but those of PettingZoo's own environments
    "ignore:Observation is not a NumPy array", "ignore:Observation space for each agent probably should be"
)
def test_aec_api_with_dict_observations(toy_env: Make) -> None:
    api_test(parallel_to_aec(toy_env(observation="features")), num_cycles=2 * FRAMES)


def test_aec_seed(toy_env: Make) -> None:
    seed_test(lambda: parallel_to_aec(toy_env()), num_cycles=FRAMES)


def test_max_cycles(toy_env: Make) -> None:
    """PettingZoo calls our `max_frames` `max_cycles`."""

    def parallel_env(max_cycles: int) -> CollaborativePerceptionEnv:
        return toy_env(max_frames=max_cycles)

    def env(max_cycles: int) -> Any:
        return parallel_to_aec(parallel_env(max_cycles))

    max_cycles_test(SimpleNamespace(parallel_env=parallel_env, env=env))


def test_render(toy_env: Make) -> None:
    render_test(lambda render_mode: parallel_to_aec(toy_env(render_mode=render_mode)))


def test_a_window_follows_the_episode(toy_env: Make) -> None:
    from matplotlib import pyplot as plt

    env = toy_env(render_mode="human")
    env.close()
    env.reset(seed=0)
    (number,) = plt.get_fignums()
    image = plt.figure(number).axes[0].images[0]
    shown = [np.array(image.get_array())]
    for _ in range(2):
        env.step({agent: env.action_space(agent).sample() for agent in env.agents})
        shown.append(np.array(image.get_array()))
    assert not np.array_equal(shown[0], shown[-1])
    assert env.render() is None
    plt.close(number)  # as a user would
    env.render()
    assert len(plt.get_fignums()) == 1
    env.close()
    env.close()
    assert not plt.get_fignums()


def test_aec_shows_the_same_state(toy_env: Make) -> None:
    env = toy_env()
    aec = parallel_to_aec(env)
    aec.reset(seed=0)
    assert np.array_equal(aec.state(), env.state())
    assert aec.state_space is env.state_space and env.state_space.contains(env.state())
    assert env.state().shape == (5, 8, 32, 32)


def test_state_is_every_vehicles_own_map(toy_env: Make) -> None:
    env = toy_env(slots="vehicles")
    observations, _ = env.reset(seed=1)
    own = np.stack([observations[f"vehicle_{i}"]["features"] for i in range(5)])
    assert np.array_equal(env.state(), own)


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.parametrize(
    "options",
    [
        {"slots": "vehicles", "rsu": True},
        {"n_vehicles": 3, "n_attackers": 1, "norm": "l2", "budget": 5.0, "action": "basis"},
        {"attackers": (0,), "knowledge": "white-box", "observation": "compact", "reward": "ap_drop"},
        {"knowledge": "gray-box", "reward": "stealth", "grace_frames": 0, "max_frames": 1},
        {"render_mode": "rgb_array", "action": "basis"},
    ],
    ids=lambda options: "-".join(map(str, options)),
)
def test_other_options_keep_the_rules(toy_env: Make, options: dict[str, Any]) -> None:
    check_env(lambda: toy_env(**options), steps=5)


def test_slots_are_constant_whoever_is_drawn(toy_env: Make) -> None:
    env = toy_env()
    drawn = set()
    for seed in range(8):
        _, infos = env.reset(seed=seed)
        assert env.agents == env.possible_agents == ["adversary_0", "adversary_1"]
        assert all(info["malicious"] == 1 for info in infos.values())
        drawn.add(tuple(info["vehicle"] for info in infos.values()))
    assert len(drawn) > 3
    assert any(0 in pair for pair in drawn), "the ego may be an attacker, too"


def test_attackers_can_be_fixed(toy_env: Make) -> None:
    env = toy_env(attackers=(3, 0))
    for seed in range(3):
        _, infos = env.reset(seed=seed)
        assert {info["vehicle"] for info in infos.values()} == {0, 3}


def test_benign_vehicles_are_marked_and_powerless(toy_env: Make) -> None:
    silent, loud = toy_env(slots="vehicles", action="full"), toy_env(slots="vehicles", action="full")
    assert silent.possible_agents == [f"vehicle_{i}" for i in range(5)]
    _, infos = silent.reset(seed=5)
    loud.reset(seed=5)
    benign = {agent for agent, info in infos.items() if not info["malicious"]}
    assert len(benign) == 3
    for _ in range(2):
        zeros = {agent: np.zeros((8, 32, 32), np.float32) for agent in silent.agents}
        shouting = {agent: action + (agent in benign) for agent, action in zeros.items()}
        a, b = silent.step(zeros), loud.step(shouting)
        assert a[1] == b[1] and a[4] == b[4]
        assert all(b[4][agent]["perturbation_norm"] == 0 for agent in benign)


def test_grace_frames_are_benign(toy_env: Make) -> None:
    env = toy_env(action="full", grace_frames=2)
    env.reset(seed=0)
    norms = []
    while env.agents:
        *_, infos = env.step({agent: np.ones((8, 32, 32), np.float32) for agent in env.agents})
        norms.append(infos["adversary_0"]["perturbation_norm"])
    assert norms == pytest.approx([0, 0, 0.3, 0.3])


def test_options_choose_the_scene_and_the_first_frame(toy_env: Make) -> None:
    env = toy_env(max_frames=2)
    seen = [
        env.reset(seed=0, options={"scene": scene, "start": start})[0]["adversary_0"]["features"]
        for scene, start in (("toy-0", 1), ("toy-0", 1), ("toy-1", 1), ("toy-0", 2))
    ]
    assert np.array_equal(seen[0], seen[1])
    assert not np.array_equal(seen[0], seen[2]) and not np.array_equal(seen[0], seen[3])


def test_step_after_the_end_asks_for_a_reset(toy_env: Make) -> None:
    env = toy_env(max_frames=1)
    with pytest.raises(ResetNeeded, match=r"call reset\(\)"):
        env.step({})
    env.reset()
    env.step({agent: env.action_space(agent).sample() for agent in env.agents})
    with pytest.raises(ResetNeeded, match=r"call reset\(\)"):
        env.step({})


def test_repr_shows_the_options(toy_env: Callable[..., CollaborativePerceptionEnv]) -> None:
    shown = repr(toy_env("robosac", n_attackers=1, max_frames=2))
    assert shown.startswith("CollaborativePerceptionEnv(defender='robosac', scenes='toy', ")
    assert "n_attackers=1, " in shown and "max_frames=2, " in shown and shown.endswith("render_mode=None)")
