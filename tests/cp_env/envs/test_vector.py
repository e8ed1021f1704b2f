"""The vector view: worlds of a batch do what each does alone, and reset themselves as gymnasium prescribes."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import cp_env
from cp_env.envs.single import JointAdversaryEnv
from cp_env.envs.vector import JointAdversaryVectorEnv
from cp_env.testing.rollout import difference
from cp_env.world.scene_cache import SceneBank
from tests.cp_env.conftest import FRAMES

Make = Callable[..., JointAdversaryVectorEnv]


@pytest.fixture
def make(bank: SceneBank) -> Make:
    def make(num_envs: int = 3, **options: Any) -> JointAdversaryVectorEnv:
        return JointAdversaryVectorEnv(num_envs, bank=bank, **{"max_frames": FRAMES, "action": "basis", **options})

    return make


@pytest.mark.parametrize("observation", ["features", "compact"])
def test_it_is_gymnasiums_own_vector_of_single_worlds(make: Make, bank: SceneBank, observation: str) -> None:
    """Bit for bit what `SyncVectorEnv` makes of three environments, over the ends of episodes, infos and all."""

    def single() -> JointAdversaryEnv:
        return JointAdversaryEnv(bank=bank, max_frames=FRAMES, action="basis", observation=observation)

    twin = SyncVectorEnv([single] * 3, autoreset_mode=AutoresetMode.SAME_STEP)
    ours = make(observation=observation)
    assert ours.observation_space == twin.observation_space and ours.action_space == twin.action_space
    assert ours.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert difference(twin.reset(seed=7), ours.reset(seed=7)) is None
    twin.action_space.seed(0)
    for _ in range(2 * FRAMES + 1):
        actions = twin.action_space.sample()
        expected, got = twin.step(actions), ours.step(actions)
        found = difference(expected, got)
        assert found is None, found
        assert ours.observation_space.contains(got[0])


def test_final_observations(make: Make) -> None:
    env = make(2)
    env.reset(seed=0)
    for frame in range(1, FRAMES + 1):
        observations, _, terminated, truncated, infos = env.step(env.action_space.sample())
        assert not terminated.any() and truncated.tolist() == [frame == FRAMES] * 2
        assert ("final_obs" in infos) is (frame == FRAMES)
    assert infos["_final_obs"].all() and infos["_final_info"].all()
    assert (infos["final_info"]["frame"] == FRAMES - 1).all() and (infos["frame"] == 0).all()
    for final, first in zip(infos["final_obs"], observations, strict=True):
        assert env.single_observation_space.contains(final) and not np.array_equal(final, first)


def test_some_worlds_can_be_reset(make: Make) -> None:
    env = make(3)
    before, _ = env.reset(seed=[1, None, 3])
    mask = np.array([False, True, False])
    after, infos = env.reset(seed=[None, 9, None], options={"reset_mask": mask})
    assert np.array_equal(before[~mask], after[~mask]) and not np.array_equal(before[1], after[1])
    assert infos["_frame"].tolist() == mask.tolist()
    alone, _ = make(1).reset(seed=9)
    assert np.array_equal(after[1], alone[0])


def test_worlds_out_of_step_end_one_by_one(make: Make) -> None:
    env = make(2)
    env.reset(seed=0)
    env.step(env.action_space.sample())
    env.reset(options={"reset_mask": np.array([False, True])})
    ends = [env.step(env.action_space.sample()) for _ in range(FRAMES)]
    assert [end[3].tolist() for end in ends[-2:]] == [[True, False], [False, True]]
    infos = ends[-2][4]
    assert infos["_final_obs"].tolist() == [True, False] and infos["final_obs"][1] is None
    assert infos["_final_info"].tolist() == infos["final_info"]["_damage"].tolist() == [True, False]


def test_without_autoreset_the_caller_resets(make: Make) -> None:
    env = make(2, autoreset_mode="Disabled", max_frames=1)
    assert env.metadata["autoreset_mode"] is AutoresetMode.DISABLED
    env.reset(seed=0)
    assert env.step(env.action_space.sample())[3].all()
    with pytest.raises(ResetNeeded, match=r"\[0, 1\] wait"):
        env.step(env.action_space.sample())
    env.reset(options={"reset_mask": np.array([True, False])})
    with pytest.raises(ResetNeeded, match=r"\[1\] wait"):
        env.step(env.action_space.sample())
    env.reset(options={"reset_mask": np.array([False, True])})
    env.step(env.action_space.sample())


def test_nothing_returned_is_touched_again(make: Make) -> None:
    env = make(2)
    kept = [env.reset(seed=0)] + [env.step(env.action_space.sample()) for _ in range(FRAMES + 1)]
    copies = pickle.loads(pickle.dumps(kept))
    env.reset()
    env.step(env.action_space.sample())
    assert difference(kept, copies) is None


def test_it_pickles(make: Make) -> None:
    env = make(2)
    env.reset(seed=0)
    env.step(env.action_space.sample())
    twin = pickle.loads(pickle.dumps(env))
    for _ in range(FRAMES):
        actions = env.action_space.sample()
        assert difference(env.step(actions), twin.step(actions)) is None


def test_a_picture_of_every_world(make: Make) -> None:
    env = make(2, render_mode="rgb_array")
    env.reset(seed=0)
    one, two = env.render()
    assert one.dtype == np.uint8 and one.shape == two.shape and one.shape[2] == 3
    window = make(2, render_mode="human")
    window.reset()
    window.step(window.action_space.sample())
    assert window.render() is None
    window.close()


def test_bad_input(make: Make) -> None:
    env = make(2)
    with pytest.raises(ResetNeeded, match="wait for reset"):
        env.step(env.action_space.sample())
    with pytest.raises(ResetNeeded, match="every world once"):
        env.reset(options={"reset_mask": np.array([True, False])})
    with pytest.raises(ValueError, match="one seed a world, 2"):
        env.reset(seed=[1, 2, 3])
    env.reset()
    for mask in ([True], np.array([False, False]), np.array([1, 0])):
        with pytest.raises(ValueError, match="reset_mask must be 2 booleans"):
            env.reset(options={"reset_mask": mask})
    with pytest.raises(ValueError, match=r"shape \(2, 32\), got \(32,\)"):
        env.step(np.zeros(32, np.float32))
    with pytest.raises(ValueError, match="NaN"):
        env.step(np.full((2, 32), np.nan, np.float32))
    with pytest.raises(ValueError, match=r"autoreset_mode must be one of \['SameStep', 'Disabled'\], got 'NextStep'"):
        make(2, autoreset_mode=AutoresetMode.NEXT_STEP)
    with pytest.raises(ValueError, match="render_mode must be None or one of"):
        make(2, render_mode="ansi")
    with pytest.raises(ValueError, match="num_envs"):
        make(0)


def test_make_vec(bank: SceneBank) -> None:
    env = gymnasium.make_vec(cp_env.ENV_ID, num_envs=2, bank=bank, max_frames=FRAMES, n_attackers=1)
    assert isinstance(env.unwrapped, JointAdversaryVectorEnv) and env.num_envs == 2
    observations, _ = env.reset(seed=0)
    assert env.observation_space.contains(observations)


def test_repr_shows_the_options(bank: SceneBank) -> None:
    shown = repr(JointAdversaryVectorEnv(3, "robosac", bank=bank, n_attackers=1, max_frames=2))
    assert shown.startswith("JointAdversaryVectorEnv(3, defender='robosac', scenes='toy', ")
    assert "n_attackers=1, " in shown and "max_frames=2, " in shown and shown.endswith("render_mode=None)")
