from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from agents.learning import ppo
from agents.learning.lstm import Memory
from agents.learning.policy import FORMAT, MAX_LOG_STD, MEMORY, Policy, load_policy, policy_names, save_policy
from agents.sb3 import make_vec_env
from cp_env.world.scene_cache import SceneBank
from defenders import names
from tests.agents.conftest import FRAMES

K = 2
KINDS = [
    pytest.param({"joint": False, "recurrent": False}, id="shared"),
    pytest.param({"joint": True, "recurrent": True}, id="joint-recurrent"),
]


@cache
def learnt(bank: SceneBank, seed: int, **kind: bool) -> Any:
    """A learner that several tests read and none changes."""
    return learner(bank, seed, **kind)


def learner(bank: SceneBank, seed: int, *, joint: bool = False, recurrent: bool = False) -> Any:
    """A learner after two updates, each of two steps of the optimiser."""
    if recurrent:
        pytest.importorskip("sb3_contrib")
    env = make_vec_env(2, bank=bank, max_frames=FRAMES, n_attackers=K, joint=joint)
    batch = {"n_steps": FRAMES, "batch_size": FRAMES * env.num_envs, "n_epochs": 2}
    return ppo.make_ppo(env, seed, recurrent=recurrent, **batch).learn(2 * FRAMES * env.num_envs)


def exported(model: Any, joint: bool = False) -> Policy:
    return ppo.export(model, "prbi", {"max_frames": FRAMES}, joint=joint, seed=0)


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_seed_learns_the_same_policy_bit_for_bit(bank: SceneBank, kind: dict[str, bool]) -> None:
    models = learnt(bank, 0, **kind), learner(bank, 0, **kind), learnt(bank, 1, **kind)
    one, two, other = (model.policy.state_dict() for model in models)
    assert all(torch.equal(one[key], two[key]) for key in one)
    assert not all(torch.equal(one[key], other[key]) for key in one)


@pytest.mark.parametrize("kind", KINDS)
def test_a_policy_plays_without_sb3_what_sb3_plays(bank: SceneBank, tmp_path: Path, kind: dict[str, bool]) -> None:
    model = learnt(bank, 0, **kind)
    save_policy(exported(model, kind["joint"]), tmp_path / "mine.safetensors")
    policy = load_policy(tmp_path / "mine.safetensors")
    seats = 3 if kind["joint"] else 3 * K
    state, rng = None, np.random.default_rng(0)
    for frame in range(4):
        seen = rng.uniform(-1, 1, (seats, *model.observation_space.shape)).astype(np.float32)
        expected, state = model.predict(seen, state, np.full(seats, frame == 0), deterministic=True)
        played = policy(seen.reshape(3, K, -1))
        assert played.shape == (3, K, 8)
        np.testing.assert_allclose(played.reshape(seats, -1), expected, atol=1e-6)
    again = policy(seen.reshape(3, K, -1))
    policy.reset()
    forgot = policy(seen.reshape(3, K, -1))
    assert np.array_equal(again, forgot) != kind["recurrent"]  # it remembers four frames, or has no memory


@pytest.mark.parametrize("kind", KINDS)
def test_a_learner_begins_where_a_policy_stands(bank: SceneBank, kind: dict[str, bool]) -> None:
    model, fresh = learnt(bank, 0, **kind), learner(bank, 1, **kind)
    ppo.adopt(fresh, exported(model, kind["joint"]))
    seen = np.random.default_rng(0).uniform(-1, 1, (4, *model.observation_space.shape)).astype(np.float32)
    expected, _ = model.predict(seen, deterministic=True)
    np.testing.assert_array_equal(fresh.predict(seen, deterministic=True)[0], expected)
    with pytest.raises(ValueError, match="another shape"):
        ppo.adopt(ppo.make_ppo(make_vec_env(2, bank=bank, knowledge="gray-box"), 0), exported(model, kind["joint"]))


def test_a_policy_survives_the_disk(bank: SceneBank, tmp_path: Path) -> None:
    policy = exported(learnt(bank, 0, joint=True, recurrent=True), joint=True)
    save_policy(policy, tmp_path / "mine.safetensors")
    loaded = load_policy(tmp_path / "mine.safetensors")
    assert (loaded.defender, loaded.options, loaded.notes, loaded.joint) == (
        ("prbi", {"max_frames": FRAMES}, policy.notes, True)
    )
    seen = np.zeros((1, K, policy.n_inputs // K), np.float32)
    drawn = loaded(seen, np.random.default_rng(0))
    assert (np.abs(drawn) <= 1).all() and not np.allclose(drawn, loaded(seen))
    with pytest.raises(ValueError, match="reads observations of"):
        loaded(seen[..., :-1])


def test_what_remembers_some_does_not_serve_others(bank: SceneBank) -> None:
    policy = exported(learnt(bank, 0, joint=True, recurrent=True))
    policy(np.zeros((4, policy.n_inputs), np.float32))
    with pytest.raises(ValueError, match="remembers 4 attackers, not 2"):
        policy(np.zeros((2, policy.n_inputs), np.float32))


def test_a_checkpoint_brings_back_network_optimiser_and_clock(bank: SceneBank, tmp_path: Path) -> None:
    model = learnt(bank, 0, joint=False, recurrent=False)
    fresh = ppo.make_ppo(make_vec_env(2, bank=bank, max_frames=FRAMES), 5)
    ppo.save_checkpoint(model, tmp_path / "checkpoint.pt")
    ppo.load_checkpoint(fresh, tmp_path / "checkpoint.pt")
    assert fresh.num_timesteps == model.num_timesteps > 0
    before, after = model.policy.state_dict(), fresh.policy.state_dict()
    assert all(torch.equal(before[key], after[key]) for key in before)
    moments, theirs = (m.policy.optimizer.state_dict()["state"] for m in (fresh, model))
    assert moments and all(torch.equal(v["exp_avg"], theirs[k]["exp_avg"]) for k, v in moments.items())
    (tmp_path / "checkpoint.pt").write_bytes(b"torn")
    with pytest.raises(ValueError, match=r"checkpoint\.pt.*delete it"):
        ppo.load_checkpoint(fresh, tmp_path / "checkpoint.pt")


@pytest.mark.parametrize("content", [None, b"torn"])
def test_broken_policy_files_are_named(content: bytes | None, tmp_path: Path) -> None:
    path = tmp_path / "mine.safetensors"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ValueError, match=r"mine\.safetensors"):
        load_policy(path)
    with pytest.raises(ValueError, match="unknown policy 'nobody'"):
        load_policy("nobody")


@pytest.mark.parametrize("name", policy_names())
def test_shipped_policies_are_small_and_name_a_defender(name: str) -> None:
    policy = load_policy(name)
    assert policy.defender.partition(":")[0] in names()
    assert policy.options and sum(weight.numel() for weight in policy.weights) < 50_000


def tensors(recurrent: bool) -> dict[str, torch.Tensor]:
    """Of a policy of three inputs and two actions, with a memory of four or without."""
    shapes = {
        "0.weight": (5, 4 if recurrent else 3),
        "0.bias": (5,),
        "1.weight": (2, 5),
        "1.bias": (2,),
        "log_std": (2,),
    }
    if recurrent:
        shapes |= dict(zip([f"memory.{name}" for name in MEMORY], [(16, 3), (16, 4), (16,), (16,)], strict=True))
    return {key: torch.full(shape, 0.1) for key, shape in shapes.items()}


ABOUT: dict[str, Any] = {"defender": "prbi", "options": {}, "notes": {}, "joint": False, "format": FORMAT}


def written(path: Path, of: dict[str, torch.Tensor], **about: Any) -> Path:
    said = {key: value for key, value in {**ABOUT, **about}.items() if value != "drop"}
    save_file(of, path, metadata={"about": json.dumps(said)})
    return path


@pytest.mark.parametrize("recurrent", [False, True])
def test_a_whole_policy_is_loaded(tmp_path: Path, recurrent: bool) -> None:
    policy = load_policy(written(tmp_path / "a.safetensors", tensors(recurrent)))
    assert policy.n_inputs == 3 and len(policy.weights) == 2 and isinstance(policy.memory, Memory) == recurrent
    assert policy(np.zeros((1, 2, 3), np.float32)).shape == (1, 2, 2)


@pytest.mark.parametrize("recurrent", [False, True])
def test_every_tensor_is_needed_and_has_one_shape_and_finite_numbers(tmp_path: Path, recurrent: bool) -> None:
    whole = tensors(recurrent)
    changes: list[Callable[[torch.Tensor], torch.Tensor]] = [
        lambda tensor: tensor * torch.nan,
        lambda tensor: tensor / 0,
        lambda tensor: tensor.double(),
        lambda tensor: tensor.long(),
        lambda tensor: tensor[None],
        lambda tensor: tensor[:0],
        lambda tensor: torch.cat([tensor, tensor]),
        lambda tensor: tensor.sum(),
    ]
    for key, tensor in whole.items():
        with pytest.raises(ValueError, match=r"a\.safetensors is no policy: .*train one anew"):
            load_policy(written(tmp_path / "a.safetensors", {k: t for k, t in whole.items() if k != key}))
        for change in changes:
            with pytest.raises(ValueError, match=r"a\.safetensors is no policy: .*train one anew"):
                load_policy(written(tmp_path / "a.safetensors", whole | {key: change(tensor).contiguous()}))


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"2.weight": torch.zeros(9, 3)}, "2.bias|2.weight"),
        ({"7.weight": torch.zeros(9, 2)}, "2.weight is missing"),
        ({"strange": torch.zeros(9)}, "beside its own, the tensor 'strange'"),
        ({"memory.bias_ih": torch.zeros(16)}, "memory.weight_hh is missing"),
        ({"log_std": torch.full((2,), MAX_LOG_STD + 1)}, "log_std must be at most"),
    ],
)
def test_tensors_that_no_policy_has(tmp_path: Path, more: dict[str, torch.Tensor], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        load_policy(written(tmp_path / "a.safetensors", tensors(False) | more))


@pytest.mark.parametrize(
    ("about", "message"),
    [
        *(({name: value}, "each of its type") for name in ABOUT if name != "format" for value in (3, None, "drop")),
        ({"more": 1}, "each of its type"),
        ({"format": "cp_env policy 2"}, "no policy of the format"),
        ({"format": ["x"]}, "no policy of the format"),
        ({"notes": {"a": json.loads("[" * 50 + "]" * 50)}}, "nested deeper"),
    ],
)
def test_what_a_policy_must_say_of_itself(tmp_path: Path, about: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=rf"a\.safetensors.*{message}"):
        load_policy(written(tmp_path / "a.safetensors", tensors(False), **about))


def test_names_that_no_file_can_have() -> None:
    for name in ("x" * 5000 + ".safetensors", "a\0b.safetensors", "/dev/zero.safetensors", ""):
        with pytest.raises(ValueError, match=r"policy"):
            load_policy(name)
