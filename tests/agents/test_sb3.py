from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from gymnasium import Wrapper

from agents import episodes, ppo
from agents.policy import load_policy, policy_names, save_policy
from agents.sb3 import AdversaryVecEnv, make_vec_env
from agents.scenes import Some
from cp_env.bank import SceneBank
from cp_env.detector import Detector
from cp_env.game import Game
from tests.toy import ToySource

FRAMES = 3
K = 2


@pytest.fixture(scope="module")
def bank(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SceneBank]:
    with torch.random.fork_rng():
        torch.manual_seed(0)
        detector = Detector(channels=8)
        with torch.no_grad():
            detector.decoder.head.bias.zero_()  # sees something everywhere
    yield SceneBank(ToySource(n_frames=FRAMES + 2), detector.freeze(), tmp_path_factory.mktemp("bank"), progress=False)


def _env(bank: SceneBank, worlds: int = 2, **knobs: Any) -> AdversaryVecEnv:
    return make_vec_env(worlds, bank=bank, max_frames=FRAMES, **({"n_attackers": K} | knobs))


def _actions(env: AdversaryVecEnv, seed: int) -> np.ndarray:
    assert env.action_space.shape is not None
    return np.random.default_rng(seed).uniform(-1, 1, (env.num_envs, *env.action_space.shape)).astype(np.float32)


def test_one_environment_a_liar(bank: SceneBank) -> None:
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


def _learner(bank: SceneBank, seed: int) -> Any:
    model = ppo.make_ppo(_env(bank), seed, n_steps=FRAMES, batch_size=6, n_epochs=2)
    return model.learn(2 * FRAMES * 2 * K)


def test_ppo_with_the_same_seed_is_bit_equal(bank: SceneBank) -> None:
    one, two, other = (_learner(bank, seed).policy.state_dict() for seed in (0, 0, 1))
    assert all(torch.equal(one[key], two[key]) for key in one)
    assert not all(torch.equal(one[key], other[key]) for key in one)


def test_a_policy_survives_the_disk_and_plays_without_sb3(bank: SceneBank, tmp_path: Path) -> None:
    model = _learner(bank, 0)
    policy = ppo.export(model, "prbi", {"max_frames": FRAMES}, seed=0)
    save_policy(policy, tmp_path / "mine.safetensors")
    loaded = load_policy(tmp_path / "mine.safetensors")
    assert (loaded.defender, loaded.knobs, loaded.notes) == ("prbi", {"max_frames": FRAMES}, policy.notes)
    observations = np.random.default_rng(0).uniform(-1, 1, (7, *model.observation_space.shape)).astype(np.float32)
    expected, _ = model.predict(observations, deterministic=True)
    np.testing.assert_allclose(loaded(observations), expected, atol=1e-6)
    drawn = loaded(observations, np.random.default_rng(0))
    assert (np.abs(drawn) <= 1).all() and not np.allclose(drawn, expected)
    with pytest.raises(ValueError, match="reads observations of"):
        loaded(observations[:, :-1])


def test_a_checkpoint_brings_back_network_optimiser_and_clock(bank: SceneBank, tmp_path: Path) -> None:
    model, fresh = _learner(bank, 0), ppo.make_ppo(_env(bank), 5)
    ppo.save_checkpoint(model, tmp_path / "checkpoint.pt")
    ppo.load_checkpoint(fresh, tmp_path / "checkpoint.pt")
    assert fresh.num_timesteps == model.num_timesteps > 0
    before, after = model.policy.state_dict(), fresh.policy.state_dict()
    assert all(torch.equal(before[key], after[key]) for key in before)
    moments = fresh.policy.optimizer.state_dict()["state"]
    assert moments and all(
        torch.equal(v["exp_avg"], model.policy.optimizer.state_dict()["state"][k]["exp_avg"])
        for k, v in moments.items()
    )
    (tmp_path / "checkpoint.pt").write_bytes(b"torn")
    with pytest.raises(ValueError, match=r"checkpoint\.pt.*delete it"):
        ppo.load_checkpoint(fresh, tmp_path / "checkpoint.pt")


def test_holdout_keeps_the_best_policy_and_a_checkpoint(bank: SceneBank, tmp_path: Path) -> None:
    knobs = {"n_attackers": K, "max_frames": FRAMES}
    game = Game(2, bank=bank, observation="compact", **knobs)
    holdout = ppo.Holdout(game, bank.source.names(), tmp_path, defender="prbi", knobs=knobs, every=1, seed=0)
    model = ppo.make_ppo(_env(bank), 0, n_steps=FRAMES, batch_size=6, n_epochs=1)
    model.learn(2 * FRAMES * 2 * K, callback=[ppo.FrameDamage(), holdout])
    assert holdout.best is not None and (tmp_path / "checkpoint.pt").exists()
    kept = load_policy(tmp_path / "policy.safetensors")
    assert kept.notes == holdout.best.notes
    again = episodes.play(game, episodes.by_policy(kept), bank.source.names(), seed=0)
    assert again.damage.mean() == pytest.approx(kept.notes["holdout_damage"], rel=1e-6)


def test_every_player_meets_the_same_episodes(bank: SceneBank) -> None:
    import agents

    game = Game(1, "none", bank=bank, max_frames=FRAMES)
    honest = episodes.play(game, episodes.by_attacker(agents.make("none")), bank.source.names(), seed=0)
    assert honest.damage.tolist() == [0.0, 0.0] and honest.frames.tolist() == [FRAMES] * 2
    assert honest.excluded.tolist() == [0.0, 0.0]
    observed = []

    def spy(game: Game, observations: Any, streams: Any) -> episodes.Move:
        observed.append(
            (observations.tobytes() if isinstance(observations, np.ndarray) else None, game.world.attackers.tolist())
        )
        return episodes.by_chance(game, observations, streams)

    for _ in range(2):
        episodes.play(game, spy, bank.source.names(), seed=0)
    assert observed[:2] == observed[2:]
    with pytest.raises(ValueError, match="fill batches"):
        episodes.play(Game(3, bank=bank), spy, bank.source.names(), seed=0)


def test_some_scenes_of_a_source() -> None:
    source = ToySource()
    assert Some(source, 2).names() == source.names() and Some(source, 1).names() == source.names()[:1]
    assert Some(source, 1).digest == source.digest  # encoded once for both
    with pytest.raises(ValueError, match="1 to 2"):
        Some(source, 3)


@pytest.mark.parametrize("content", [None, b"torn"])
def test_broken_policy_files_are_named(content: bytes | None, tmp_path: Path) -> None:
    path = tmp_path / "mine.safetensors"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ValueError, match=r"mine\.safetensors"):
        load_policy(path)
    with pytest.raises(ValueError, match="unknown policy 'nobody'"):
        load_policy("nobody")


def test_shipped_policies_are_small_and_load() -> None:
    for name in policy_names():
        policy = load_policy(name)
        assert policy.knobs and sum(weight.numel() for weight in policy.weights) < 50_000
