"""PPO's frames per second over the native `VecEnv` and over SuperSuit's way from PettingZoo, in one run.

    make library-supersuit && .venv-supersuit/bin/python -m benchmarks.supersuit_frames

Both learn from the same worlds (a toy crossing, the detector that ships, PRBI, two attackers of five), one torch thread
and one process; seconds are the processor's, the rounds of the two alternate.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import supersuit
import torch
import tyro
from stable_baselines3.common.vec_env import VecEnv

import cp_env
from agents.learning.ppo import make_ppo
from agents.sb3 import make_vec_env
from cp_env.scenes.subset import SceneSubset
from tests.helpers.toy_scenes import ToySource

SCENE = SceneSubset(ToySource(n_frames=12), 1)
ATTACKERS = 2


@dataclass
class Args:
    worlds: int = 8
    steps: int = 16
    """frames of a rollout"""
    rounds: int = 3


def native(worlds: int, **options: Any) -> VecEnv:
    return make_vec_env(worlds, **options)


def through_supersuit(worlds: int, **options: Any) -> VecEnv:
    world = supersuit.pettingzoo_env_to_vec_env_v1(cp_env.parallel_env(observation="compact", **options))
    return supersuit.concat_vec_envs_v1(world, worlds, num_cpus=0, base_class="stable_baselines3")


def seconds(make: Callable[..., VecEnv], args: Args, **options: Any) -> float:
    """Of one rollout and one update. No seed: the other way has no use for one."""
    env = make(args.worlds, **options)
    env.reset()
    model = make_ppo(env, None, n_steps=args.steps, batch_size=64)
    start = time.process_time()
    model.learn(args.steps * args.worlds * ATTACKERS)
    return time.process_time() - start


def main(args: Args) -> None:
    torch.set_num_threads(1)
    for action in ("guided", "basis"):
        options = {
            "scenes": SCENE,
            "action": action,
            "knowledge": "gray-box",
            "max_frames": 10,
            "n_attackers": ATTACKERS,
        }
        rows = np.array(
            [[seconds(make, args, **options) for make in (native, through_supersuit)] for _ in range(args.rounds)]
        )
        ours, theirs = args.worlds * args.steps / rows.T
        ratio = ours / theirs
        print(
            f"{action}, frames/s: native {np.median(ours):.1f}, SuperSuit {np.median(theirs):.1f} (medians of rounds)"
        )
        print(f"  native over SuperSuit: {np.median(ratio):.2f} ({ratio.min():.2f} to {ratio.max():.2f})")


if __name__ == "__main__":
    main(tyro.cli(Args))
