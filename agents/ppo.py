"""PPO from Stable-Baselines3 over the native `VecEnv`: settings that fit the game, checkpoints, held-out evaluation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv

from agents.episodes import by_policy, play
from agents.policy import Policy, save_policy
from cp_env.game import Game

PPO_KNOBS: dict[str, Any] = {
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


def make_ppo(env: VecEnv, seed: int, *, tensorboard: Path | None = None, **knobs: Any) -> PPO:
    """A fresh learner on one torch thread's worth of network; `knobs` override `PPO_KNOBS`."""
    log = None if tensorboard is None else str(tensorboard)
    return PPO(
        "MlpPolicy", env, seed=seed, policy_kwargs=NETWORK, tensorboard_log=log, device="cpu", **(PPO_KNOBS | knobs)
    )


def export(model: PPO, defender: str, knobs: dict[str, Any], **notes: Any) -> Policy:
    """The actor of `model`, cut out of SB3."""
    layers = [m for m in [*model.policy.mlp_extractor.policy_net, model.policy.action_net] if hasattr(m, "weight")]
    return Policy(
        weights=tuple(layer.weight.detach().clone() for layer in layers),
        biases=tuple(layer.bias.detach().clone() for layer in layers),
        log_std=model.policy.log_std.detach().clone(),
        defender=defender,
        knobs=dict(knobs),
        notes=notes | {"timesteps": int(model.num_timesteps)},
    )


def save_checkpoint(model: PPO, path: Path) -> None:
    """Network, optimiser and clock; the file appears whole or not at all."""
    partial = path.with_suffix(".part")
    state = {
        "policy": model.policy.state_dict(),
        "optimizer": model.policy.optimizer.state_dict(),
        "timesteps": int(model.num_timesteps),
    }
    torch.save(state, partial)
    partial.replace(path)


def load_checkpoint(model: PPO, path: Path) -> None:
    """Go on from a checkpoint of the same settings. Raises ValueError if it is broken or does not fit."""
    try:
        state = torch.load(path, weights_only=True)
        model.policy.load_state_dict(state["policy"])
        model.policy.optimizer.load_state_dict(state["optimizer"])
        model.num_timesteps = int(state["timesteps"])
    except Exception as error:
        raise ValueError(f"cannot go on from {path}: {error}; delete it to begin anew") from error


class Holdout(BaseCallback):
    """After every `every` rollouts and at the end: a checkpoint, and the damage per episode on scenes not trained on.

    The policy that did most damage is kept in `best`, and in the file `policy.safetensors` of `folder`.
    """

    def __init__(
        self,
        game: Game,
        scenes: Sequence[str],
        folder: Path,
        *,
        defender: str,
        knobs: dict[str, Any],
        every: int,
        seed: int,
    ) -> None:
        super().__init__()
        self.game, self.scenes, self.folder, self.every = game, list(scenes), folder, every
        self.defender, self.knobs, self.training_seed = defender, knobs, seed
        self.best: Policy | None = None
        self._rollouts = 0

    def _on_rollout_start(self) -> None:
        if self._rollouts and self._rollouts % self.every == 0:
            self._look()
        self._rollouts += 1

    def _on_training_end(self) -> None:
        self._look()

    def _on_step(self) -> bool:
        return True

    def _look(self) -> None:
        policy = export(self.model, self.defender, self.knobs, seed=self.training_seed)  # type: ignore[arg-type]
        episodes = play(self.game, by_policy(policy), self.scenes, seed=0)
        policy.notes.update(holdout_damage=float(episodes.damage.mean()), holdout_scenes=len(self.scenes))
        self.logger.record("holdout/damage", float(episodes.damage.mean()))
        self.logger.record("holdout/excluded", float(episodes.excluded.mean()))
        self.logger.record("holdout/similarity", float(episodes.similarity.mean()))
        self.logger.dump(self.num_timesteps)
        if self.best is None or policy.notes["holdout_damage"] > self.best.notes["holdout_damage"]:
            self.best = policy
            save_policy(policy, self.folder / "policy.safetensors")
        save_checkpoint(self.model, self.folder / "checkpoint.pt")  # type: ignore[arg-type]
        self.policy = policy


class FrameDamage(BaseCallback):
    """TensorBoard curves of what the frames of a rollout looked like."""

    KEYS = ("damage", "similarity", "verifications", "excluded", "perturbation_norm")

    def _on_training_start(self) -> None:
        self._seen: dict[str, list[float]] = {key: [] for key in self.KEYS}

    def _on_step(self) -> bool:
        for key in self.KEYS:
            self._seen[key] += [info[key] for info in self.locals["infos"]]
        return True

    def _on_rollout_end(self) -> None:
        for key, values in self._seen.items():
            self.logger.record(f"frame/{key}", float(np.mean(values)))
            values.clear()
