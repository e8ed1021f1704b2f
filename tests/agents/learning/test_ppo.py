"""Checkpoints: what was learned comes back to the bit, and a file that does not fit changes nothing."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import load_file, save_file
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from torch import Tensor

from agents.learning import ppo
from agents.sb3 import make_vec_env
from cp_env.world.scene_cache import SceneBank
from tests.agents.conftest import FRAMES

Tensors = dict[str, Tensor]


@pytest.fixture(scope="module")
def learned(bank: SceneBank) -> OnPolicyAlgorithm:
    """A learner after one rollout: its optimiser has moments."""
    env = make_vec_env(2, "prbi", bank=bank, max_frames=FRAMES)
    return ppo.make_ppo(env, 0, n_steps=FRAMES, batch_size=6, n_epochs=1).learn(1)


@pytest.fixture
def fresh(learned: OnPolicyAlgorithm) -> OnPolicyAlgorithm:
    assert learned.env is not None
    return ppo.make_ppo(learned.env, 1, n_steps=FRAMES, batch_size=6, n_epochs=1)


def told(model: OnPolicyAlgorithm) -> dict[str, bytes]:
    """The bits of network and optimiser, and the clock."""
    state = {key: tensor.detach().numpy().tobytes() for key, tensor in ppo._state(model).items()}
    return {**state, "timesteps": str(model.num_timesteps).encode()}


def test_a_checkpoint_brings_everything_back(
    learned: OnPolicyAlgorithm, fresh: OnPolicyAlgorithm, tmp_path: Path
) -> None:
    path = tmp_path / "checkpoint.safetensors"
    ppo.save_checkpoint(learned, path)
    assert told(fresh) != told(learned)
    ppo.load_checkpoint(fresh, path)
    assert told(fresh) == told(learned) and any(key.startswith("optimizer.") for key in told(learned))
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


def test_one_without_a_step_has_no_moments(fresh: OnPolicyAlgorithm, tmp_path: Path) -> None:
    path = tmp_path / "checkpoint.safetensors"
    ppo.save_checkpoint(fresh, path)
    before = told(fresh)
    ppo.load_checkpoint(fresh, path)
    assert told(fresh) == before and not any(key.startswith("optimizer.") for key in before)


def _first(tensors: Tensors, part: str) -> str:
    return next(key for key in sorted(tensors) if key.startswith(part) and tensors[key].dim())


def _changed(part: str, change: Callable[[Tensor], Tensor]) -> Callable[[Tensors], Tensors]:
    return lambda tensors: {**tensors, _first(tensors, part): change(tensors[_first(tensors, part)])}


def _without(part: str) -> Callable[[Tensors], Tensors]:
    return lambda tensors: {key: value for key, value in tensors.items() if key != _first(tensors, part)}


MISFITS: dict[str, tuple[Callable[[Tensors], Tensors], str]] = {
    "network missing": (_without("network."), "lacks"),
    "moment missing": (_without("optimizer."), "lacks"),
    "one too many": (lambda tensors: {**tensors, "network.other": torch.zeros(2)}, "holds, beside its own"),
    "moment of none": (lambda tensors: {**tensors, "optimizer.999.step": torch.zeros(())}, "holds, beside its own"),
    "no number": (lambda tensors: {**tensors, "optimizer.x.step": torch.zeros(())}, "holds, beside its own"),
    "network's shape": (_changed("network.", lambda old: old[..., :-1].contiguous()), r"is \("),
    "moment's shape": (_changed("optimizer.", lambda old: old[..., None].contiguous()), r"is \("),
    "type": (_changed("network.", lambda old: old.double()), "float64"),
    "nan": (_changed("network.", lambda old: torch.full_like(old, torch.nan)), "not finite"),
    "infinite moment": (_changed("optimizer.", lambda old: torch.full_like(old, torch.inf)), "not finite"),
}


@pytest.mark.parametrize("name", MISFITS)
def test_what_does_not_fit_changes_nothing(
    learned: OnPolicyAlgorithm, fresh: OnPolicyAlgorithm, name: str, tmp_path: Path
) -> None:
    path = tmp_path / "checkpoint.safetensors"
    ppo.save_checkpoint(learned, path)
    change, message = MISFITS[name]
    about = {"about": json.dumps({"format": ppo.FORMAT, "timesteps": 6})}
    save_file(change(load_file(path)), path, metadata=about)
    before = told(fresh)
    with pytest.raises(ValueError, match=f"cannot go on from .*{message}.*; delete it to begin anew"):
        ppo.load_checkpoint(fresh, path)
    assert told(fresh) == before


@pytest.mark.parametrize("about", [{}, {"format": "x"}, {"timesteps": -1}, {"timesteps": "6"}, {"timesteps": 2**70}])
def test_notes_that_say_something_else(
    learned: OnPolicyAlgorithm, fresh: OnPolicyAlgorithm, about: dict[str, Any], tmp_path: Path
) -> None:
    path = tmp_path / "checkpoint.safetensors"
    ppo.save_checkpoint(learned, path)
    said = {"format": ppo.FORMAT, **about} if about else {}
    save_file(load_file(path), path, metadata={"about": json.dumps(said)})
    with pytest.raises(ValueError, match="cannot go on from"):
        ppo.load_checkpoint(fresh, path)


class Payload:
    def __reduce__(self) -> Any:
        return pytest.fail, ("a checkpoint was unpickled",)


@pytest.mark.parametrize(
    "content", [b"", b"torn", pickle.dumps(Payload()), b"\xff" * 64, b"\x10" + b"\0" * 7 + b"[" * 16]
)
def test_files_that_are_none(fresh: OnPolicyAlgorithm, content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "checkpoint.safetensors"
    path.write_bytes(content)
    with pytest.raises(ValueError, match="cannot go on from"):
        ppo.load_checkpoint(fresh, path)
