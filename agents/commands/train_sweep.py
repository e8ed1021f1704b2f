"""Train attacks against several defenders, in several configurations and seeds; keep the strongest against each.

    cp-train sweep --defenders prbi robosac --seeds 0 1

Every run has a folder under --out; started again, finished runs are skipped and killed ones go on from their last
checkpoint. Written there: sweep.json and sweep.md (what every configuration reached on the scenes held back), and
strongest/ with one policy a defender, which `cp-play` plays on test scenes.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

from rich.console import Console
from rich.markdown import Markdown

from agents.learning.rollout import open_bank
from agents.learning.sweep import TrainingRun, keep, plan_sweep, summarise, sweep, write_table
from agents.learning.training import Recipe
from cp_env.progress import Progress, say, track


@dataclass(frozen=True)
class Args:
    """Train many attacks."""

    defenders: Sequence[str] = ("prbi", "robosac", "pasac:score=similarity", "bayes")
    """the defenders to beat"""
    configurations: Sequence[str] = ("shared", "joint:joint=True,knowledge=white-box")
    """names, with what differs from the recipe: name:field=value,field=value"""
    seeds: Sequence[int] = (0, 1)
    recipe: Recipe = field(default_factory=lambda: Recipe(frames=3_000, n_scenes=8, every=4))
    """what all runs share"""
    workers: int = os.cpu_count() or 1
    """runs trained at once, each in a process with one torch thread"""
    out: Path = Path("runs/sweep")
    keep: Path | None = None
    """folder for the strongest policies; <out>/strongest if not given"""


def learn(args: Args) -> list[TrainingRun]:
    """Train all runs of the sweep; returns them."""
    recipe = args.recipe
    runs = plan_sweep(
        recipe, defenders=args.defenders, configurations=args.configurations, seeds=args.seeds, root=args.out
    )
    total = sum(run.recipe.n_segments * run.recipe.segment for run in runs)
    say(f"plan: {len(runs)} runs, {total} frames in all, {args.workers} workers")
    for scenes, n_scenes in ((recipe.scenes, recipe.n_scenes), (recipe.holdout, recipe.n_holdout)):
        bank = open_bank(scenes, n_scenes, recipe.victim, recipe.fusion)  # encoded here once, not by every worker
        for name in track(bank.source.names(), f"encoding {scenes}", unit="scene"):
            bank.episode(name, recipe.n_vehicles, rsu=recipe.rsu).encode()
    with Progress("learning", total, "frame") as progress:
        for frames in sweep(runs, args.workers):
            progress.to(frames)
    return runs


def report(runs: Sequence[TrainingRun], args: Args) -> tuple[str, list[Path]]:
    """The table (Markdown), which is also written, and the policies that are kept."""
    table = write_table(summarise(runs), args.out, {"recipe": asdict(args.recipe), "seeds": list(args.seeds)})
    return table, keep(runs, args.keep or args.out / "strongest")


def program(args: Args, command: str) -> None:
    """Train, and say what was reached."""
    del command
    table, kept = report(learn(args), args)
    Console().print(Markdown(table))
    Console().print(f"wrote {args.out}/sweep.md, sweep.json and {', '.join(map(str, kept))}", soft_wrap=True)
