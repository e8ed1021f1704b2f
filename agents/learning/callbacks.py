"""Evaluation while PPO learns: held-back scenes between the rollouts, and the frames of every rollout."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm

from agents.learning.policy import Policy, save_policy
from agents.learning.rollout import Episodes
from cp_env.evaluation.plan.files import write_atomically

EVALUATED = ("damage", "similarity", "verifications", "excluded", "critical")

Evaluation = dict[str, float]
"""Means of `Episodes` over the held-back scenes, after so many "frames" of learning."""


class Holdout(BaseCallback):
    """Evaluates the policy on held-back scenes: before it learns, after every `every` rollouts, at the end of `learn`.

    Each evaluation is added to the learning curve, `curve.json` in `folder`. The policy with the highest `measure` so
    far is kept there as `policy.safetensors`. A learner that goes on from a checkpoint goes on with the curve that led
    to it.

    Args:
        play: whole episodes of a policy on the scenes held back.
        make: the learner's policy as it is now.
        folder: where curve and policy are written.
        every: rollouts between two evaluations.
        per_frame: steps that the learner counts in one frame of one world.
        measure: one of EVALUATED, by which the policy to keep is chosen.
    """

    def __init__(
        self,
        play: Callable[[Policy], Episodes],
        make: Callable[[OnPolicyAlgorithm], Policy],
        folder: Path,
        *,
        every: int,
        per_frame: int = 1,
        measure: str = "damage",
    ) -> None:
        super().__init__()
        self.measure = measure
        self.play, self.make, self.folder, self.every, self.per_frame = play, make, folder, every, per_frame
        self.curve: list[Evaluation] = read_curve(folder)

    @property
    def highest(self) -> float:
        """The highest `measure` of any evaluation so far, per frame."""
        return max((evaluation[self.measure] for evaluation in self.curve), default=-np.inf)

    def _on_training_start(self) -> None:
        self._rollouts = 0
        self.curve = [evaluation for evaluation in self.curve if evaluation["frames"] <= self._now]
        if not self.curve:
            self._evaluate()

    def _on_rollout_start(self) -> None:
        if self._rollouts and self._rollouts % self.every == 0:
            self._evaluate()
        self._rollouts += 1

    def _on_training_end(self) -> None:
        self._evaluate()

    def _on_step(self) -> bool:
        return True

    @property
    def _now(self) -> int:
        return self.model.num_timesteps // self.per_frame

    def _evaluate(self) -> None:
        policy = self.make(self.model)  # type: ignore[arg-type]
        episodes = self.play(policy)
        evaluation = {key: float(getattr(episodes, key).mean()) for key in EVALUATED} | {"frames": self._now}
        for key, value in evaluation.items():
            self.logger.record(f"holdout/{key}", value)
        self.logger.dump(self.num_timesteps)
        if evaluation[self.measure] > self.highest:
            held_back = {f"holdout_{name}": evaluation[name] for name in dict.fromkeys(("damage", self.measure))}
            policy.notes.update(held_back, holdout_scenes=len(episodes.damage))
            save_policy(policy, self.folder / "policy.safetensors")
        self.curve.append(evaluation)
        write_atomically(self.folder / "curve.json", json.dumps(self.curve, indent=1))


def read_curve(folder: Path) -> list[Evaluation]:
    """The learning curve that a run in `folder` has drawn so far."""
    path = folder / "curve.json"
    curve: list[Evaluation] = json.loads(path.read_text()) if path.exists() else []
    return curve


class FrameDamage(BaseCallback):
    """TensorBoard curves of the frames' means in each rollout."""

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
