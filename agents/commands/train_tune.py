"""Tune PPO's hyperparameters with Optuna: trials on training scenes, compared on calibration scenes; as a file.

    cp-train tune --trials 20 --recipe.defender prbi
    cp-train attack --defender prbi --hyperparameters runs/tune/hyperparameters.json

The first trial plays the recipe's own values. Started again with the same --out the study goes on, with more trials if
more are asked for. Written there: hyperparameters.json (the best so far), trials.json, and the runs of every trial.
Optuna is an extra: pip install 'cp-env[agents,tune]'.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

from rich.console import Console

from agents.learning.training import Recipe
from agents.learning.tuning import FILE, Trial, tune
from cp_env.evaluation.plan.files import write_atomically
from cp_env.progress import Progress, say


@dataclass(frozen=True)
class Args:
    """Tune PPO's hyperparameters."""

    recipe: Recipe = field(default_factory=lambda: Recipe(frames=2_048, n_scenes=8, every=4))
    """what all trials share; its hyperparameters are the first trial"""
    trials: int = 20
    """how many there are to be in all"""
    seeds: Sequence[int] = (0, 1)
    """of the learners: a trial trains one policy for each, and is compared by their mean"""
    seed: int = 0
    """of the search"""
    out: Path = Path("runs/tune")


def search(args: Args) -> list[Trial]:
    """Play the trials that are missing; returns all of them."""
    runs = args.trials * len(args.seeds)
    recipe = args.recipe
    say(
        f"plan: {args.trials} trials of {len(args.seeds)} policies, {runs * recipe.n_segments * recipe.segment} frames "
        f"in all, compared on {recipe.n_holdout} scenes of {recipe.holdout}, one process"
    )
    done: list[Trial] = []
    with Progress("tuning", args.trials, "trial") as progress:
        for trial in tune(recipe, args.out, trials=args.trials, seeds=args.seeds, seed=args.seed):
            done.append(trial)
            best = max(done, key=lambda one: one.score)
            progress.advance(note=f"the best so far is trial {best.number}, {best.score:.3f}")
    return done


def program(args: Args, command: str) -> None:
    """Tune, write, and say what was found."""
    done = search(args)
    trials = {"command": command, "trials": [asdict(trial) for trial in done]}
    write_atomically(args.out / "trials.json", json.dumps(trials, indent=1) + "\n")
    best = max(done, key=lambda trial: trial.score)
    console = Console()
    console.print(
        f"detection loss/frame on {args.recipe.holdout}, mean over {len(args.seeds)} seeds: {best.score:.3f} in trial "
        f"{best.number}, {done[0].score:.3f} with the recipe's own values; the best of {len(done)} is biased upwards",
        soft_wrap=True,
        highlight=False,
    )
    console.print(f"the hyperparameters: {args.out / FILE}; take them by cp-train attack --hyperparameters FILE")
