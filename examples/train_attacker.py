"""Train an attack with PPO against a defender, follow it in TensorBoard, keep the policy that did most damage.

    python examples/train_attacker.py --seed 1
    python examples/train_attacker.py --defender robosac --joint --knowledge white-box
    tensorboard --logdir runs

Started again with the same --out it goes on from its last checkpoint, bit for bit as if it had never been stopped.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import torch
import tyro
from rich.console import Console
from tqdm import tqdm

from agents.learning.training import Recipe, train


@dataclass
class Args:
    recipe: tyro.conf.OmitArgPrefixes[Recipe] = field(default_factory=Recipe)
    out: Path | None = None
    """folder for checkpoints, curves and the policy; runs/<defender>-<seed> if not given"""


def main(args: Args) -> None:
    torch.set_num_threads(1)
    out = args.out or Path("runs") / f"{args.recipe.defender}-{args.recipe.seed}"
    with tqdm(total=args.recipe.frames, unit="frame", desc="learning") as bar:
        curve = train(args.recipe, out, tensorboard=True, report_progress=lambda frames: bar.update(frames - bar.n))
    most = max(evaluation["damage"] for evaluation in curve)
    Console().print(f"highest detection loss/frame on {args.recipe.holdout}: {most:.3f}")
    Console().print(f"the policy is in {out / 'policy.safetensors'}; play it with examples/play_attacker.py")


if __name__ == "__main__":
    main(tyro.cli(Args))
