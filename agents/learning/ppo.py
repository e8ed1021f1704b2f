"""PPO from Stable-Baselines3 over the native `VecEnv`: settings that fit the game, the actor cut out, checkpoints."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import save_file
from stable_baselines3 import PPO
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.vec_env import VecEnv
from torch import Tensor

from agents.learning.hyperparameters import PPO_OPTIONS
from agents.learning.lstm import Memory
from agents.learning.policy import MEMORY, Policy
from cp_env.detector.model.tensors import read_tensors
from cp_env.scenes.formats.bounded import parse_json

NETWORK: dict[str, Any] = {"net_arch": {"pi": [64, 64], "vf": [64, 64]}, "log_std_init": -0.7}
"""Exploration begins at half the action range: at SB3's usual deviation of 1 most numbers would be clipped."""

MEMORY_SIZE = 64
"""Hidden units of a recurrent policy's LSTM."""

FORMAT = "cp_env ppo checkpoint 1"
NETWORK_PART = "network."
"""What the names of the network's tensors begin with in a checkpoint; the others are the optimiser's."""


def make_ppo(env: VecEnv, seed: int | None, *, recurrent: bool = False, **options: Any) -> OnPolicyAlgorithm:
    """A fresh PPO learner on the CPU.

    Args:
        env: the environments it learns in.
        seed: of the learner.
        recurrent: with an LSTM before the actor.
        options: of PPO; they override `PPO_OPTIONS`.

    Returns:
        The learner.

    Raises:
        ValueError: a recurrent one is asked for and sb3-contrib is not installed.
    """
    options = PPO_OPTIONS | options
    if not recurrent:
        return PPO("MlpPolicy", env, policy_kwargs=NETWORK, seed=seed, device="cpu", **options)
    try:
        from sb3_contrib import RecurrentPPO
    except ImportError as error:
        raise ValueError("a recurrent policy is learned by sb3-contrib: pip install 'cp-env[recurrent]'") from error
    network = NETWORK | {"lstm_hidden_size": MEMORY_SIZE}
    return RecurrentPPO("MlpLstmPolicy", env, policy_kwargs=network, seed=seed, device="cpu", **options)


def adopt(model: OnPolicyAlgorithm, policy: Policy) -> None:
    """Let the actor of a learner begin where a policy stands; its critic begins anew.

    Raises:
        ValueError: the policy has another shape than the learner's actor.
    """
    layers, lstm = _layers(model), getattr(model.policy, "lstm_actor", None)
    pairs: list[tuple[Tensor, Tensor]] = [(model.policy.log_std, policy.log_std)]
    pairs += [(layer.weight, weight) for layer, weight in zip(layers, policy.weights, strict=True)]
    pairs += [(layer.bias, bias) for layer, bias in zip(layers, policy.biases, strict=True)]
    if lstm is not None and policy.memory is not None:
        pairs += [(getattr(lstm, f"{name}_l0"), getattr(policy.memory, name)) for name in MEMORY]
    if (lstm is None) != (policy.memory is None) or any(mine.shape != theirs.shape for mine, theirs in pairs):
        raise ValueError("a policy of another shape cannot be learned on: choose its knowledge, joint and recurrent")
    with torch.no_grad():
        for mine, theirs in pairs:
            mine.copy_(theirs)


def _layers(model: OnPolicyAlgorithm) -> list[torch.nn.Linear]:
    """The actor's linear layers, first to last."""
    modules = [*model.policy.mlp_extractor.policy_net, model.policy.action_net]
    return [module for module in modules if isinstance(module, torch.nn.Linear)]


def export(
    model: OnPolicyAlgorithm, defender: str, options: dict[str, Any], *, joint: bool = False, **notes: Any
) -> Policy:
    """The actor of `model`, cut out of SB3, with its memory if it has one."""
    layers, lstm = _layers(model), getattr(model.policy, "lstm_actor", None)
    return Policy(
        weights=tuple(layer.weight.detach().clone() for layer in layers),
        biases=tuple(layer.bias.detach().clone() for layer in layers),
        log_std=model.policy.log_std.detach().clone(),
        defender=defender,
        options=dict(options),
        notes=notes | {"timesteps": int(model.num_timesteps)},
        joint=joint,
        memory=None if lstm is None else Memory(*(getattr(lstm, f"{name}_l0").detach().clone() for name in MEMORY)),
    )


def save_checkpoint(model: OnPolicyAlgorithm, path: Path) -> None:
    """Network, optimiser and clock as safetensors; the file appears whole or not at all."""
    tensors = {key: tensor.detach().cpu().contiguous() for key, tensor in _state(model).items()}
    about = {"format": FORMAT, "timesteps": int(model.num_timesteps)}
    partial = path.with_suffix(".part")
    save_file(tensors, partial, metadata={"about": json.dumps(about)})
    partial.replace(path)


def load_checkpoint(model: OnPolicyAlgorithm, path: Path) -> None:
    """Go on from a checkpoint of the same settings. The learner changes only if the whole file fits.

    Raises:
        ValueError: the checkpoint is broken, or does not fit: a tensor is missing, not asked for, of another shape or
            type, or holds a number that is not finite.
    """
    try:
        notes, tensors = read_tensors(path)
        about = parse_json(notes.get("about", "{}"))
        if not isinstance(about, dict) or about.get("format") != FORMAT:
            raise ValueError(f"it is none of the format {FORMAT!r}")
        timesteps = about.get("timesteps")
        if type(timesteps) is not int or not 0 <= timesteps < 2**63:
            raise ValueError(f"its number of steps is {timesteps!r:.40}")
        _check(tensors, model)
    except (OSError, ValueError) as error:
        raise ValueError(f"cannot go on from {path}: {error}; delete it to begin anew") from error
    network = {key.removeprefix(NETWORK_PART): value for key, value in tensors.items() if key.startswith(NETWORK_PART)}
    moments: dict[int, dict[str, Tensor]] = {}
    for key in tensors.keys() - {NETWORK_PART + name for name in network}:
        _, number, name = key.split(".", 2)
        moments.setdefault(int(number), {})[name] = tensors[key]
    optimizer = model.policy.optimizer
    model.policy.load_state_dict(network)
    optimizer.load_state_dict({"state": moments, "param_groups": optimizer.state_dict()["param_groups"]})
    model.num_timesteps = timesteps


def _state(model: OnPolicyAlgorithm) -> dict[str, Tensor]:
    """Every tensor of the network, and of the optimiser for each of its parameters."""
    moments = model.policy.optimizer.state_dict()["state"]
    return {f"{NETWORK_PART}{name}": tensor for name, tensor in model.policy.state_dict().items()} | {
        f"optimizer.{number}.{name}": tensor for number, of in moments.items() for name, tensor in of.items()
    }


def _check(tensors: dict[str, Tensor], model: OnPolicyAlgorithm) -> None:
    """ValueError unless these are the tensors of a checkpoint of that learner."""
    wanted = {f"{NETWORK_PART}{name}": tensor.shape for name, tensor in model.policy.state_dict().items()}
    if any(key.startswith("optimizer.") for key in tensors):  # it has none before the first step
        (group,) = model.policy.optimizer.param_groups
        for number, parameter in enumerate(group["params"]):
            shapes = {"step": torch.Size(), "exp_avg": parameter.shape, "exp_avg_sq": parameter.shape}
            wanted |= {f"optimizer.{number}.{name}": shape for name, shape in shapes.items()}
    if wrong := sorted(wanted.keys() ^ tensors.keys()):
        raise ValueError(f"it {'lacks' if wrong[0] in wanted else 'holds, beside its own,'} {wrong[0][:80]!r}")
    for key, shape in wanted.items():
        if tensors[key].shape != shape or tensors[key].dtype != torch.float32:
            raise ValueError(f"{key} is {tuple(tensors[key].shape)} of {tensors[key].dtype}, not {tuple(shape)}")
        if not bool(torch.isfinite(tensors[key]).all()):
            raise ValueError(f"{key} holds numbers that are not finite")
