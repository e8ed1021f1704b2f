"""Train an attack with PPO against a defender, follow it in TensorBoard, keep the policy that did most damage.

    cp-train attack --seed 1
    cp-train attack --defender robosac --joint --knowledge white-box
    cp-train attack --hyperparameters runs/tune/hyperparameters.json       # those that cp-train tune found
    cp-train attack --detector cp_env:weights=runs/mine/mean.safetensors --scenes mine:Folder:folder=data
    tensorboard --logdir runs

Started again with the same --out it goes on from its last checkpoint, bit for bit as if it had never been stopped.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from pathlib import Path

import tyro
from rich.console import Console

from agents.learning.callbacks import Evaluation
from agents.learning.hyperparameters import read_hyperparameters
from agents.learning.training import Recipe, train
from cp_env.progress import Progress, say


@dataclass(frozen=True)
class Args:
    """Train an attack."""

    recipe: tyro.conf.OmitArgPrefixes[Recipe] = field(default_factory=Recipe)
    out: Path | None = None
    """folder for checkpoints, curves and the policy; runs/<defender>-<seed> if not given"""

    hyperparameters: Path | None = None
    """of PPO, in place of the defaults above: a name of agents.learning.hyperparameters.tuned_names(), or a file .json
    as `cp-train tune` writes it"""

    def settled(self) -> Recipe:
        """The recipe with the hyperparameters of the file.

        Raises:
            ValueError: a file that cannot be read, or a hyperparameter that is given here as well, with another value.
        """
        if self.hyperparameters is None:
            return self.recipe
        values, default = read_hyperparameters(self.hyperparameters), Recipe()
        for name, value in values.items():
            own = getattr(self.recipe, name)
            if own not in (value, getattr(default, name)):
                raise ValueError(f"{name} is {own} here and {value} in {self.hyperparameters}; give it once")
        return replace(self.recipe, **values)

    @property
    def folder(self) -> Path:
        """Of the run."""
        return self.out or Path("runs") / f"{self.recipe.defender}-{self.recipe.seed}"


def follow(args: Args) -> list[Evaluation]:
    """Train, with a bar or lines of progress, and TensorBoard's curves where it is installed; returns the curve."""
    recipe = args.settled()
    say(f"plan: {recipe.n_segments * recipe.segment} frames in {recipe.worlds} worlds, seed {recipe.seed}, one process")
    with Progress("learning", recipe.n_segments * recipe.segment, "frame") as progress:
        return train(recipe, args.folder, tensorboard=find_spec("tensorboard") is not None, report_progress=progress.to)


def program(args: Args, command: str) -> None:
    """Train, and say what was reached."""
    del command
    most = max(evaluation["damage"] for evaluation in follow(args))
    Console().print(f"highest detection loss/frame on {args.recipe.holdout}: {most:.3f}", soft_wrap=True)
    Console().print(f"the policy: {args.folder / 'policy.safetensors'}; play it with cp-play", soft_wrap=True)
