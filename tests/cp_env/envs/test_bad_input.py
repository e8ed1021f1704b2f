"""What bad input gets: a ValueError that states the rule, the value and the way out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch

import cp_env
from agents.sb3 import make_vec_env
from cp_env.envs.parallel import CollaborativePerceptionEnv
from cp_env.envs.single import JointAdversaryEnv
from cp_env.envs.vector import JointAdversaryVectorEnv
from cp_env.world.scene_cache import SceneBank
from cp_env.world.verification import DefenderError
from defenders import Defender, Query, Verdict

Make = Callable[..., CollaborativePerceptionEnv]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"defender": "robosac!"}, "unknown defender 'robosac!'.*prbi"),
        ({"fusion": "median"}, "fusion must be one of mean.*not 'median'"),
        ({"action": "raw"}, "action must be one of guided, stealth, critical, basis, full, not 'raw'"),
        ({"observation": "pixels"}, "observation must be one of features, compact.*not 'pixels'"),
        ({"knowledge": "grey"}, "knowledge must be one of black-box, gray-box, white-box.*not 'grey'"),
        ({"reward": "fame"}, "reward must be one of damage, ap_drop, stealth.*not 'fame'"),
        ({"norm": "l1"}, "norm must be one of linf, l2.*not 'l1'"),
        ({"slots": "pairs"}, "slots must be one of adversaries, vehicles.*not 'pairs'"),
        ({"render_mode": "ansi"}, "render_mode must be None or one of .*'human', 'rgb_array'.*, got 'ansi'"),
        ({"n_attackers": 5}, "0 <= k < n: k = 5, n_vehicles = 5"),
        ({"n_attackers": -1}, "k = -1"),
        ({"n_attackers": 0}, "at least one adversary: set n_attackers >= 1"),
        ({"attackers": (0, 5)}, r"distinct numbers from 0 \(the ego\) to 4, not \[0, 5\]"),
        ({"attackers": (1, 1)}, r"distinct numbers .* not \[1, 1\]"),
        ({"attackers": (0, 1, 2, 3, 4)}, "leave one vehicle benign: 5 of 5 are malicious"),
        ({"n_vehicles": 1, "n_attackers": 0}, "n_vehicles must be at least 2"),
        ({"budget": -0.1}, "budget Δ must be a finite number from 0 to 65504, not -0.1"),
        ({"budget": float("nan")}, "budget must be a finite number, not nan"),
        ({"max_frames": 0}, "max_frames must be at least 1, not 0"),
        ({"grace_frames": -1}, "grace_frames must be at least 0, not -1"),
    ],
    ids=lambda value: "-".join(map(str, value.items())) if isinstance(value, dict) else "",
)
def test_bad_settings(toy_env: Make, options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        toy_env(**options)


def test_unknown_scenes_list_the_known() -> None:
    with pytest.raises(ValueError, match=r"unknown scenes 'village'.*town/test"):
        CollaborativePerceptionEnv("none", scenes="village")


def test_more_vehicles_than_a_scene_holds(toy_env: Make) -> None:
    env = toy_env(n_vehicles=6)
    with pytest.raises(ValueError, match=r"n_vehicles = 6, but scene 'toy-\d' holds only 5 .* lower n_vehicles"):
        env.reset(seed=0)


@pytest.mark.parametrize("make", [cp_env.parallel_env, cp_env.env, lambda **options: cp_env.vector_env(2, **options)])
def test_more_vehicles_than_any_scene_holds_are_refused_at_once(make: Callable[..., object]) -> None:
    with pytest.raises(ValueError, match=r"n_vehicles = 9, but scene '.*' holds only \d+ .* lower n_vehicles"):
        make(n_vehicles=9)


def test_options(toy_env: Make) -> None:
    env = toy_env()
    with pytest.raises(ValueError, match="start must be a frame of scene"):
        env.reset(options={"start": 99})
    with pytest.raises(ValueError, match=r"unknown option of reset 'strat' .did you mean 'start'"):
        env.reset(options={"strat": 1})
    env.reset(options={"options": 1})  # as PettingZoo's own test does


@pytest.mark.parametrize(
    "options",
    [
        {"start": 99},
        {"start": 1.5},
        {"start": True},
        {"start": "0"},
        {"scene": "nowhere"},
        {"scene": 3},
        {"absent": {0: [1]}},
        {"absent": 3},
        {"strat": 1},
    ],
)
def test_a_refused_reset_changes_nothing(toy_env: Make, options: Any) -> None:
    """The episode goes on as if it had not been asked for, and so does the stream of episodes."""
    refused, undisturbed = toy_env(observation="compact"), toy_env(observation="compact")
    actions = {agent: np.full(8, 0.5, np.float32) for agent in refused.possible_agents}
    for env in (refused, undisturbed):
        env.reset(seed=3)
        env.step(actions)
    with pytest.raises(ValueError, match=r"start|scene|absent|option"):
        refused.reset(seed=5, options=options)
    with pytest.raises(ValueError, match=r"start|scene|absent|option"):
        refused.reset(options=options)
    for _ in range(2):
        (one, *_), (other, *_) = refused.step(actions), undisturbed.step(actions)
        assert all(np.array_equal(one[agent], other[agent]) for agent in actions)
    one, other = refused.reset()[0], undisturbed.reset()[0]
    assert all(np.array_equal(one[agent], other[agent]) for agent in actions)


@pytest.mark.parametrize("seed", [-1, 0.5, "zero"])
def test_seeds(toy_env: Make, seed: Any) -> None:
    with pytest.raises((ValueError, TypeError)):
        toy_env().reset(seed=seed)


def test_seed_zero_is_a_seed(toy_env: Make) -> None:
    env = toy_env(observation="compact")
    first, again = (env.reset(seed=0)[0]["adversary_0"] for _ in range(2))
    assert np.array_equal(first, again)


@pytest.mark.parametrize("method", ["observation_space", "action_space"])
def test_unknown_agents(toy_env: Make, method: str) -> None:
    with pytest.raises(ValueError, match=r"no agent 'adversary_2'; the agents are \['adversary_0', 'adversary_1'\]"):
        getattr(toy_env(), method)("adversary_2")


def test_actions(toy_env: Make) -> None:
    env = toy_env(action="basis")
    env.reset(seed=0)
    good = np.zeros(16, np.float32)
    both = {"adversary_0": good, "adversary_1": good}
    with pytest.raises(ValueError, match=r"the action of 'adversary_1' must have shape \(16,\), got \(4,\)"):
        env.step({**both, "adversary_1": good[:4]})
    with pytest.raises(ValueError, match=r"none was given for \['adversary_1'\]"):
        env.step({"adversary_0": good})
    with pytest.raises(ValueError, match="no agent 'adversary_7'"):
        env.step({**both, "adversary_7": good})
    with pytest.raises(ValueError, match="must be finite"):
        env.step({**both, "adversary_0": np.full(16, np.nan, np.float32)})
    env.step({agent: action.tolist() for agent, action in both.items()})  # a list of numbers will do


class Stumbles(Defender):
    """Fuses everyone, and raises in frame 2 of worlds whose dice say so."""

    def __init__(self, share: float = 1.0) -> None:
        self.share = share
        self.clumsy = False

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        self.everyone = range(n_vehicles)
        self.clumsy = rng.random() < self.share

    def inspect(self, frame: Any) -> Any:
        if self.clumsy and frame.index == 2:
            yield Query([[99]])
        return Verdict(self.everyone)


def test_a_failing_defender_ends_the_episode_by_name(toy_env: Make) -> None:
    env = toy_env(Stumbles())
    env.reset(seed=0)
    for _ in range(2):
        env.step({agent: env.action_space(agent).sample() for agent in env.agents})
    with pytest.raises(DefenderError, match=r"defender Stumbles failed in frame 2.*vehicles 0..4, not .99."):
        env.step({agent: env.action_space(agent).sample() for agent in env.agents})
    assert env.agents == []
    env.reset()
    env.step({agent: env.action_space(agent).sample() for agent in env.agents})


def test_a_failing_defender_ends_the_single_agents_episode(bank: Any) -> None:
    env = JointAdversaryEnv(Stumbles(), bank=bank, max_frames=4, action="basis")
    env.reset(seed=0)
    for _ in range(2):
        env.step(env.action_space.sample())
    with pytest.raises(DefenderError, match="defender Stumbles failed in frame 2"):
        env.step(env.action_space.sample())
    env.reset()


def test_in_a_batch_the_other_worlds_go_on(bank: Any) -> None:
    env = JointAdversaryVectorEnv(4, Stumbles(0.5), bank=bank, max_frames=4, action="basis")
    calm = JointAdversaryVectorEnv(4, Stumbles(0.0), bank=bank, max_frames=4, action="basis")
    env.reset(seed=0)
    calm.reset(seed=0)
    clumsy = np.array([defender.clumsy for defender in env.game.world.defenders])
    assert 0 < clumsy.sum() < 4
    for _ in range(2):
        actions = env.action_space.sample()
        env.step(actions), calm.step(actions)
    actions = env.action_space.sample()
    with pytest.warns(RuntimeWarning, match="its episode ends here, the others go on: defender Stumbles failed"):
        observations, rewards, _, truncated, infos = env.step(actions)
    expected = calm.step(actions)
    assert np.array_equal(truncated, clumsy)
    assert np.array_equal(observations[~clumsy], expected[0][~clumsy])
    assert np.array_equal(rewards[~clumsy], expected[1][~clumsy])
    assert (infos["final_info"]["failed"][clumsy] == 1).all() and (infos["failed"] == 0).all()


NO_ACTIONS = {
    "text": "0.5",
    "bytes": b"0.5",
    "texts": ["0.5"] * 16,
    "complex": np.full(16, 0.5 + 0.5j),
    "masked": np.ma.masked_array(np.zeros(16), mask=[True] * 16),
    "huge": [10**400] * 16,
    "large": np.full(16, 1e300),
    "objects": [None] * 16,
    "ragged": [[0.0], [0.0, 1.0]],
    "graph": torch.zeros(16, requires_grad=True),
    "nan": np.full(16, np.nan),
    "short": np.zeros(15),
    "none": None,
    "date": np.zeros(16, "datetime64[s]"),
}


@pytest.mark.parametrize("action", NO_ACTIONS.values(), ids=NO_ACTIONS)
def test_what_is_no_action_is_a_value_error_everywhere(toy_env: Make, bank: SceneBank, action: Any) -> None:
    """In the parallel view, the joint one, the vector one and SB3's; nothing is played."""
    parallel = toy_env(action="basis")
    parallel.reset(seed=0)
    single = JointAdversaryEnv("none", bank=bank, action="basis", n_attackers=1)
    single.reset(seed=0)
    vector = JointAdversaryVectorEnv(1, "none", bank=bank, action="basis", n_attackers=1)
    vector.reset(seed=0)
    sb3 = make_vec_env(1, "none", bank=bank, action="basis", n_attackers=1)
    sb3.reset()
    plays: list[Callable[[], Any]] = [
        lambda: parallel.step({"adversary_0": action, "adversary_1": np.zeros(16)}),
        lambda: single.step(action),
        lambda: vector.step([action]),
        lambda: sb3.step([action]),
    ]
    for play in plays:
        with pytest.raises(ValueError, match="action"):
            play()
    assert parallel.game.outcome is None and single.game.outcome is None


@pytest.mark.parametrize("actions", [[0.5, 0.5], "adversary_0", None, 3])
def test_actions_that_are_no_dict(toy_env: Make, actions: Any) -> None:
    env = toy_env()
    env.reset(seed=0)
    with pytest.raises(ValueError, match="step\\(\\) takes a dict from agent to action"):
        env.step(actions)
