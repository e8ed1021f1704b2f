"""PPO from Stable-Baselines3 over the native `VecEnv`: settings that fit the game, the actor cut out, checkpoints."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.vec_env import VecEnv
from torch import Tensor

from agents.learning.lstm import Memory
from agents.learning.policy import MEMORY, Policy

PPO_OPTIONS: dict[str, Any] = {
    "n_steps": 32,
    "batch_size": 128,
    "n_epochs": 8,
    "learning_rate": 1e-3,
    "gamma": 0.9,
    "gae_lambda": 0.9,
    "ent_coef": 0.0,
}
"""Few and costly frames, returns that hang on the next seconds: short rollouts, a short horizon."""

NETWORK: dict[str, Any] = {"net_arch": {"pi": [64, 64], "vf": [64, 64]}, "log_std_init": -0.7}
"""Exploration begins at half the action range: at SB3's usual deviation of 1 most numbers would be clipped."""

MEMORY_SIZE = 64
"""Hidden units of a recurrent policy's LSTM."""


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
    """Network, optimiser and clock; the file appears whole or not at all."""
    partial = path.with_suffix(".part")
    state = {
        "policy": model.policy.state_dict(),
        "optimizer": model.policy.optimizer.state_dict(),
        "timesteps": int(model.num_timesteps),
    }
    torch.save(state, partial)
    partial.replace(path)


def load_checkpoint(model: OnPolicyAlgorithm, path: Path) -> None:
    """Go on from a checkpoint of the same settings.

    Raises:
        ValueError: the checkpoint is broken or does not fit.
    """
    try:
        state = torch.load(path, weights_only=True)
        model.policy.load_state_dict(state["policy"])
        model.policy.optimizer.load_state_dict(state["optimizer"])
        model.num_timesteps = int(state["timesteps"])
    except Exception as error:
        raise ValueError(f"cannot go on from {path}: {error}; delete it to begin anew") from error
