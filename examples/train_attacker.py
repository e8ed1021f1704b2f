"""Train an attacker with PPO against a defender, watch it in TensorBoard, keep the policy that did most damage.

    python examples/train_attacker.py --seed 1
    tensorboard --logdir runs

Started again with the same --out it goes on from its last checkpoint.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
import tyro
from rich.console import Console
from stable_baselines3.common.vec_env import VecMonitor

from agents.ppo import FrameDamage, Holdout, load_checkpoint, make_ppo
from agents.sb3 import make_vec_env
from agents.scenes import Some
from cp_env.game import Game


@dataclass
class Args:
    defender: str = "prbi"
    """whom to beat: any name of defenders.names()"""
    seed: int = 0
    """of the learner, the scenes and the liars"""
    frames: int = 5_000
    """frames of traffic to learn from, all worlds together"""
    worlds: int = 8
    """worlds stepped together"""
    n_vehicles: int = 5
    n_attackers: int = 2
    knowledge: str = "gray-box"
    """how much of the defender the policy sees: black-box, gray-box or white-box"""
    max_frames: int = 50
    """length of an episode"""
    scenes: str = "town/train"
    n_scenes: int = 12
    """how many of them to learn on: each is encoded once, which takes seconds"""
    holdout: str = "town/calibration"
    """scenes on which the policy to keep is chosen"""
    n_holdout: int = 6
    """how many of them, one episode each"""
    every: int = 5
    """rollouts between two checkpoints"""
    learning_rate: float = 1e-3
    gamma: float = 0.9
    out: Path | None = None
    """folder for checkpoints, curves and the policy; runs/<defender>-<seed> if not given"""


def main(args: Args) -> None:
    torch.set_num_threads(1)
    out = args.out or Path("runs") / f"{args.defender}-{args.seed}"
    out.mkdir(parents=True, exist_ok=True)
    knobs: dict[str, Any] = {
        "n_vehicles": args.n_vehicles,
        "n_attackers": args.n_attackers,
        "action": "guided",
        "observation": "compact",
        "knowledge": args.knowledge,
        "max_frames": args.max_frames,
    }
    env = VecMonitor(make_vec_env(args.worlds, args.defender, scenes=Some(args.scenes, args.n_scenes), **knobs))
    env.seed(args.seed)
    model = make_ppo(env, args.seed, tensorboard=out, learning_rate=args.learning_rate, gamma=args.gamma)
    checkpoint = out / "checkpoint.pt"
    if checkpoint.exists():
        load_checkpoint(model, checkpoint)

    held_out = Some(args.holdout, args.n_holdout)
    holdout = Holdout(
        Game(args.n_holdout, args.defender, scenes=held_out, **knobs),
        held_out.names(),
        out,
        defender=args.defender,
        knobs=knobs,
        every=args.every,
        seed=args.seed,
    )
    left = args.frames * args.n_attackers - model.num_timesteps
    if left > 0:
        model.learn(
            left, callback=[FrameDamage(), holdout], reset_num_timesteps=not model.num_timesteps, progress_bar=True
        )
        assert holdout.best is not None
        Console().print(f"most damage per episode on {args.holdout}: {holdout.best.notes['holdout_damage']:.1f}")
    Console().print(f"the policy is in {out / 'policy.safetensors'}; play it with examples/play_attacker.py")


if __name__ == "__main__":
    main(tyro.cli(Args))
