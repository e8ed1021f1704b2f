"""Train an attack with PPO against a defender, follow it in TensorBoard, keep the policy that did most damage.

    python examples/train_attacker.py --seed 1
    python examples/train_attacker.py --defender robosac --joint --knowledge white-box
    tensorboard --logdir runs

The program `cp-train attack` on one page. Started again with the same --out it goes on from its last checkpoint, bit
for bit as if it had never been stopped.
"""

from __future__ import annotations

import torch
import tyro
from rich.console import Console

from agents.commands.train_attack import Args
from agents.learning.training import train
from cp_env.progress import Progress


def main(args: Args) -> None:
    torch.set_num_threads(1)
    recipe = args.settled()
    with Progress("learning", recipe.n_segments * recipe.segment, "frame") as progress:
        curve = train(recipe, args.folder, tensorboard=True, report_progress=progress.to)
    most = max(evaluation["damage"] for evaluation in curve)
    Console().print(f"highest detection loss/frame on {recipe.holdout}: {most:.3f}")
    Console().print(f"the policy is in {args.folder / 'policy.safetensors'}; play it with cp-play")


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
