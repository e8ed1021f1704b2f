"""Train attacks against several defenders, in several configurations and seeds; keep the strongest against each.

    python examples/sweep_attackers.py --defenders prbi robosac --seeds 0 1

Every run has a folder under --out; started again, finished runs are skipped and killed ones go on from their last
checkpoint. Written there: sweep.json and sweep.md (what every configuration reached on the scenes held back),
curves.png, and strongest/ with one policy a defender, which examples/play_attacker.py plays on test scenes.
"""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass, field
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import torch
import tyro
from matplotlib.axes import Axes
from rich.console import Console
from rich.markdown import Markdown
from tqdm import tqdm

from agents.learning.sweep import TrainingRun, keep, plan_sweep, summarise, sweep, write_table
from agents.learning.training import Recipe, open_bank

SHOWN = {"damage": "detection loss/frame", "excluded": "share of attackers excluded"}


@dataclass
class Args:
    defenders: list[str] = field(default_factory=lambda: ["prbi", "robosac", "pasac:score=similarity", "bayes"])
    """the defenders to beat"""
    configurations: list[str] = field(default_factory=lambda: ["shared", "joint:joint=True,knowledge=white-box"])
    """names, with what differs from the recipe: name:field=value,field=value"""
    seeds: list[int] = field(default_factory=lambda: [0, 1])
    recipe: Recipe = field(default_factory=lambda: Recipe(frames=3_000, n_scenes=8, every=4))
    """what all runs share"""
    workers: int = os.cpu_count() or 1
    """runs trained at once, each in a process with one torch thread"""
    out: Path = Path("runs/sweep")
    keep: Path | None = None
    """folder for the strongest policies; <out>/strongest if not given"""


def main(args: Args) -> None:
    torch.set_num_threads(1)
    runs = plan_sweep(
        args.recipe, defenders=args.defenders, configurations=args.configurations, seeds=args.seeds, root=args.out
    )
    for scenes, n_scenes in ((args.recipe.scenes, args.recipe.n_scenes), (args.recipe.holdout, args.recipe.n_holdout)):
        bank = open_bank(scenes, n_scenes)  # encoded here once, not by every worker
        for name in bank.source.names():
            bank.episode(name, args.recipe.n_vehicles, rsu=False).encode()
    total = sum(run.recipe.n_segments * run.recipe.segment for run in runs)
    with tqdm(total=total, unit="frame", desc="learning") as bar:
        for frames in sweep(runs, args.workers):
            bar.update(frames - bar.n)
    table = write_table(summarise(runs), args.out, {"recipe": asdict(args.recipe), "seeds": args.seeds})
    draw(runs, args.out / "curves.png")
    kept = keep(runs, args.keep or args.out / "strongest")
    console = Console()
    console.print(Markdown(table))
    console.print(f"wrote {args.out}/sweep.md, sweep.json, curves.png and {', '.join(map(str, kept))}")


def draw(runs: list[TrainingRun], path: Path) -> None:
    """Learning curves on the scenes held back: mean over seeds, and their range; a column a defender."""
    defenders = list(dict.fromkeys(run.recipe.defender for run in runs))
    figure, grid = plt.subplots(
        len(SHOWN), len(defenders), figsize=(3.4 * len(defenders) + 1.0, 5.6), sharex=True, sharey="row", squeeze=False
    )
    for row, (key, label) in zip(grid, SHOWN.items(), strict=True):
        for axes, defender in zip(row, defenders, strict=True):
            _curves(axes, [run for run in runs if run.recipe.defender == defender], key)
        row[0].set(ylabel=label, ylim=(0, 1) if key == "excluded" else (0, None))
    for axes, defender in zip(grid[0], defenders, strict=True):
        axes.set_title(defender, fontsize=10)
    for axes in grid[-1]:
        axes.set_xlabel("frames learned from")
    handles, labels = grid[0][0].get_legend_handles_labels()
    seeds = len({run.recipe.seed for run in runs})
    title = f"mean and range over {seeds} seeds" if seeds > 1 else "one seed"
    figure.legend(handles, labels, loc="upper center", ncols=len(labels), frameon=False, title=title)
    figure.tight_layout(rect=(0, 0, 1, 0.9))
    figure.savefig(path, dpi=130)
    plt.close(figure)


def _curves(axes: Axes, runs: list[TrainingRun], key: str) -> None:
    names = list(dict.fromkeys(run.configuration for run in runs))
    for colour, name in enumerate(names):
        curves = [run.curve for run in runs if run.configuration == name]
        frames = [evaluation["frames"] for evaluation in curves[0]]
        values = np.array([[evaluation[key] for evaluation in curve] for curve in curves])
        axes.plot(frames, values.mean(0), f"C{colour}o-", ms=3, label=name)
        axes.fill_between(frames, values.min(0), values.max(0), color=f"C{colour}", alpha=0.2, lw=0)
    axes.grid(alpha=0.3)


if __name__ == "__main__":
    main(tyro.cli(Args))
