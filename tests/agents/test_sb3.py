from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar

import numpy as np
import pytest
from gymnasium import Wrapper
from stable_baselines3.common.vec_env import VecMonitor, VecVideoRecorder

from agents.sb3 import AdversaryVecEnv, make_vec_env
from cp_env.envs.core import Game
from cp_env.envs.vector import JointAdversaryVectorEnv
from cp_env.world.scene_cache import SceneBank
from tests.agents.conftest import FRAMES

K = 2


def _env(bank: SceneBank, worlds: int = 2, **options: Any) -> AdversaryVecEnv:
    return make_vec_env(worlds, bank=bank, max_frames=FRAMES, **({"n_attackers": K} | options))


def _actions(env: AdversaryVecEnv, seed: int) -> np.ndarray:
    assert env.action_space.shape is not None
    return np.random.default_rng(seed).uniform(-1, 1, (env.num_envs, *env.action_space.shape)).astype(np.float32)


def test_one_environment_an_attacker(bank: SceneBank) -> None:
    env = _env(bank, worlds=3)
    env.seed(0)
    observations = env.reset()
    assert env.num_envs == 6 and isinstance(observations, np.ndarray)
    assert observations.shape == (6, *env.observation_space.shape) and observations.dtype == np.float32
    assert all(env.observation_space.contains(row) for row in observations)
    assert env.get_attr("render_mode") == [None] * 6 and env.env_is_wrapped(Wrapper) == [False] * 6
    vehicles = [info["vehicle"] for info in env.reset_infos]
    assert vehicles == env.game.world.attackers.ravel().tolist()


def test_an_episode_ends_and_the_next_begins_in_the_same_step(bank: SceneBank) -> None:
    env, twin = _env(bank), Game(2, bank=bank, max_frames=FRAMES, observation="compact")
    env.seed(7)
    env.reset()
    twin.reset([7, 7 + K])
    for t in range(2 * FRAMES):
        actions = _actions(env, t)
        observations, rewards, dones, infos = env.step(actions)
        last, expected, truncated, _ = twin.step(actions.reshape(2, K, -1))
        over = (t + 1) % FRAMES == 0
        assert dones.tolist() == [over] * env.num_envs and truncated.tolist() == [over] * 2
        np.testing.assert_array_equal(rewards, expected.ravel())
        assert rewards.dtype == np.float32
        assert all(info.get("TimeLimit.truncated", False) == over for info in infos)
        if over:
            np.testing.assert_array_equal(
                np.stack([info["terminal_observation"] for info in infos]), last.reshape(4, -1)
            )
            last, _ = twin.reset([None, None])
        assert all("terminal_observation" not in info for info in infos) or over
        np.testing.assert_array_equal(observations, last.reshape(4, -1))


def test_seeds_and_options_hold_for_one_reset(bank: SceneBank) -> None:
    env = _env(bank)
    env.seed(3)
    env.set_options({"scene": "toy-1", "start": 0})
    first = env.reset()
    assert [episode.scene.name for episode, _ in env.game.world.places] == ["toy-1"] * 2
    assert env._seeds == [None] * 4 and env._options == [{}] * 4
    second = env.reset()
    env.seed(3)
    env.set_options({"scene": "toy-1", "start": 0})
    np.testing.assert_array_equal(env.reset(), first)
    np.testing.assert_array_equal(env.reset(), second)
    env.set_options([{"scene": "toy-0"}, {}, {"scene": "toy-1"}, {}])
    env.reset()
    assert [episode.scene.name for episode, _ in env.game.world.places] == ["toy-0", "toy-1"]


def test_dict_observations_are_stacked_by_key(bank: SceneBank) -> None:
    env = _env(bank, observation="features")
    env.seed(0)
    observations = env.reset()
    assert isinstance(observations, dict)
    for _ in range(FRAMES):
        observations, _, _, infos = env.step(_actions(env, 0))
    assert {key: value.shape for key, value in observations.items()} == {
        key: (env.num_envs, *space.shape) for key, space in env.observation_space.items()
    }
    assert set(infos[0]["terminal_observation"]) == set(env.observation_space.spaces)


def test_infos_are_numbers_and_the_callers_own(bank: SceneBank) -> None:
    env = _env(bank)
    env.seed(0)
    env.reset()
    _, _, _, infos = env.step(_actions(env, 0))
    assert all(isinstance(value, float) for info in infos for value in info.values())
    infos[0]["damage"] = -1.0
    _, _, _, again = env.step(_actions(env, 1))
    assert again[0] is not infos[0] and infos[0]["damage"] == -1.0


def test_bad_calls_are_refused(bank: SceneBank) -> None:
    env = _env(bank)
    env.reset()
    with pytest.raises(RuntimeError, match="step_async"):
        env.step_wait()
    with pytest.raises(ValueError, match="finite"):
        env.step(np.full((4, 8), np.nan, dtype=np.float32))
    with pytest.raises(ValueError, match="render_mode"):
        make_vec_env(1, bank=bank, render_mode="ansi")


def test_joint_and_shared_see_the_same_world(bank: SceneBank) -> None:
    shared, joint = _env(bank), _env(bank, joint=True)
    twin = JointAdversaryVectorEnv(2, bank=bank, max_frames=FRAMES, n_attackers=K)
    assert joint.num_envs == 2
    assert joint.observation_space == twin.single_observation_space
    assert joint.action_space == twin.single_action_space
    shared.seed(5), joint.seed(5)  # a world takes its first slot's seed: 5 and 7, 5 and 6
    shared._seeds = [5, 6, 6, 7]
    mine, ours = shared.reset(), joint.reset()
    theirs, _ = twin.reset(seed=5)
    for t in range(FRAMES + 1):
        np.testing.assert_array_equal(mine.reshape(2, -1), ours)
        np.testing.assert_array_equal(ours, theirs)
        actions = _actions(shared, t)
        mine, paid, dones, infos = shared.step(actions)
        ours, rewards, over, joint_infos = joint.step(actions.reshape(2, -1))
        theirs, expected, *_ = twin.step(actions.reshape(2, -1))
        np.testing.assert_array_equal(paid.reshape(2, K)[:, 0], rewards)
        np.testing.assert_allclose(rewards, expected, rtol=1e-6)
        assert dones.reshape(2, K)[:, 0].tolist() == over.tolist() == [t + 1 == FRAMES] * 2
        assert joint_infos[1]["excluded"] == np.mean([infos[2]["excluded"], infos[3]["excluded"]])
        if over.all():
            last = [np.concatenate([infos[K * e + j]["terminal_observation"] for j in range(K)]) for e in range(2)]
            np.testing.assert_array_equal(np.stack([info["terminal_observation"] for info in joint_infos]), last)


def test_joint_features_are_laid_end_to_end(bank: SceneBank) -> None:
    env = _env(bank, joint=True, observation="features")
    env.seed(0)
    observations = env.reset()
    assert isinstance(observations, dict)
    assert all(env.observation_space[key].contains(value[0]) for key, value in observations.items())


class Clip:
    """MoviePy's clip, which keeps what the recorder gives it."""

    made: ClassVar[list[Clip]] = []

    def __init__(self, frames: list[np.ndarray], fps: float) -> None:
        self.frames, self.fps, self.path = frames, fps, ""
        self.made.append(self)

    def write_videofile(self, path: str) -> None:
        self.path = path


@pytest.mark.parametrize("joint", [False, True], ids=["shared", "joint"])
def test_sb3s_recorder_films_each_world_once_at_the_true_rate(
    joint: bool, bank: SceneBank, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = ["moviepy", "moviepy.video", "moviepy.video.io", "moviepy.video.io.ImageSequenceClip"]
    for name in names:
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    monkeypatch.setattr(sys.modules[names[-1]], "ImageSequenceClip", Clip, raising=False)
    monkeypatch.setattr(Clip, "made", [])
    venv = VecMonitor(_env(bank, worlds=3, joint=joint, render_mode="rgb_array"))
    film = VecVideoRecorder(venv, str(tmp_path), lambda step: step == 0, video_length=2)
    film.seed(0)
    film.reset()
    worlds = [venv.venv.game.render(e) for e in range(3)]  # type: ignore[attr-defined]
    for t in range(2):
        film.step(_actions(venv.venv, t))  # type: ignore[arg-type]
    film.close()
    (clip,) = Clip.made
    assert clip.fps == 1 / bank.source.load("toy-0").dt == 5
    assert len(clip.frames) == 3 and clip.path.endswith(".mp4")
    height, width = worlds[0].shape[:2]
    assert clip.frames[0].shape == (2 * height, 2 * width, 3)  # three worlds in a square of four
    for e, picture in enumerate(worlds):
        row, column = divmod(e, 2)
        tile = clip.frames[0][row * height : (row + 1) * height, column * width : (column + 1) * width]
        np.testing.assert_array_equal(tile, picture)
    assert all(size % 2 == 0 for size in clip.frames[0].shape[:2]), "H.264 needs even sizes"


def test_repr_shows_the_options(bank: SceneBank) -> None:
    shown = repr(_env(bank, worlds=3, reward="stealth"))
    assert shown.startswith("AdversaryVecEnv(3, defender='prbi', scenes='toy', n_vehicles=5, n_attackers=2, ")
    assert "reward='stealth', budget=0.3, norm='linf'" in shown and f"max_frames={FRAMES}" in shown
    assert shown.endswith("joint=False, render_mode=None)")
