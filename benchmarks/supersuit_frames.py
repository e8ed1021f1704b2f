"""PPO's frames per second over the native `VecEnv` and over SuperSuit's way from PettingZoo, in one run.

    make library-supersuit && .venv-supersuit/bin/python -m benchmarks.supersuit_frames

Both learn from the same eight worlds (a toy crossing, the detector that ships, PRBI, two liars of five), one torch thread
and one process; seconds are the processor's, the rounds of the two alternate.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import supersuit
import torch
from stable_baselines3.common.vec_env import VecEnv

import cp_env
from agents.ppo import make_ppo
from agents.sb3 import make_vec_env
from agents.scenes import Some
from tests.toy import ToySource

WORLDS, STEPS, ROUNDS, LIARS = 8, 16, 3, 2

SCENE = Some(ToySource(n_frames=12), 1)


def native(**knobs: Any) -> VecEnv:
    return make_vec_env(WORLDS, **knobs)


def through_supersuit(**knobs: Any) -> VecEnv:
    world = supersuit.pettingzoo_env_to_vec_env_v1(cp_env.parallel_env(observation="compact", **knobs))
    return supersuit.concat_vec_envs_v1(world, WORLDS, num_cpus=0, base_class="stable_baselines3")


def seconds(make: Callable[..., VecEnv], **knobs: Any) -> float:
    """Of one rollout and one update. No seed: the other way has no use for one."""
    env = make(**knobs)
    env.reset()
    model = make_ppo(env, None, n_steps=STEPS, batch_size=64)
    start = time.process_time()
    model.learn(STEPS * WORLDS * LIARS)
    return time.process_time() - start


def main() -> None:
    torch.set_num_threads(1)
    for action in ("guided", "basis"):
        knobs = {"scenes": SCENE, "action": action, "knowledge": "gray-box", "max_frames": 10, "n_attackers": LIARS}
        rows = np.array([[seconds(make, **knobs) for make in (native, through_supersuit)] for _ in range(ROUNDS)])
        ours, theirs = WORLDS * STEPS / rows.T
        print(
            f"{action}: native {ours.max():.1f} frames/s (median {np.median(ours):.1f}), "
            f"SuperSuit {theirs.max():.1f} ({np.median(theirs):.1f}), ratio of medians "
            f"{np.median(ours) / np.median(theirs):.2f}, of pairs {(ours / theirs).min():.2f} to {(ours / theirs).max():.2f}"
        )


if __name__ == "__main__":
    main()
