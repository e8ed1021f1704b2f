"""Train attacks against several defenders, in several configurations and seeds; keep the strongest against each.

    python examples/sweep_attackers.py --defenders prbi robosac --seeds 0 1

The program `cp-train sweep`, and a picture of the learning curves besides. Every run has a folder under --out; started
again, finished runs are skipped and killed ones go on from their last checkpoint. Written there: sweep.json and
sweep.md (what every configuration reached on the scenes held back), curves.png, and strongest/ with one policy a
defender, which `cp-play` plays on test scenes.
"""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import torch
import tyro
from matplotlib.axes import Axes
from rich.console import Console
from rich.markdown import Markdown

from agents.commands.train_sweep import Args, learn, report
from agents.learning.sweep import TrainingRun
from cp_env.rendering import style

SHOWN = {"damage": "detection loss/frame", "excluded": "share of attackers excluded"}


def main(args: Args) -> None:
    torch.set_num_threads(1)
    runs = learn(args)
    table, kept = report(runs, args)
    draw(runs, args.out / "curves.png")
    Console().print(Markdown(table))
    Console().print(f"wrote {args.out}/sweep.md, sweep.json, curves.png and {', '.join(map(str, kept))}")


@style.plot_style()
def draw(runs: list[TrainingRun], path: Path) -> None:
    """Learning curves on the scenes held back: mean over seeds, and their range; a column a defender."""
    defenders = list(dict.fromkeys(run.recipe.defender for run in runs))
    figure, grid = plt.subplots(
        len(SHOWN),
        len(defenders),
        figsize=(max(style.PAGE, 2.3 * len(defenders)), 5.0),
        sharex=True,
        sharey="row",
        squeeze=False,
        layout="constrained",
    )
    for row, (key, label) in zip(grid, SHOWN.items(), strict=True):
        for axes, defender in zip(row, defenders, strict=True):
            _curves(axes, [run for run in runs if run.recipe.defender == defender], key)
        row[0].set(ylabel=label, ylim=(0, 1) if key == "excluded" else (0, None))
    for axes, defender in zip(grid[0], defenders, strict=True):
        axes.set_title(defender)
    for axes in grid[-1]:
        axes.set_xlabel("frames learned from")
    handles, labels = grid[0][0].get_legend_handles_labels()
    seeds = len({run.recipe.seed for run in runs})
    title = f"mean and range over {seeds} seeds" if seeds > 1 else "one seed"
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 5), title=title)
    style.save_plot(figure, path)
    plt.close(figure)


def _curves(axes: Axes, runs: list[TrainingRun], key: str) -> None:
    names = list(dict.fromkeys(run.configuration for run in runs))
    for colour, name in enumerate(names):
        curves = [run.curve for run in runs if run.configuration == name]
        frames = [evaluation["frames"] for evaluation in curves[0]]
        values = np.array([[evaluation[key] for evaluation in curve] for curve in curves])
        axes.plot(frames, values.mean(0), f"C{colour}o-", ms=3, label=name)
        axes.fill_between(frames, values.min(0), values.max(0), color=f"C{colour}", alpha=0.2, lw=0)
    axes.xaxis.set_major_formatter("{x:,.0f}")


if __name__ == "__main__":
    main(tyro.cli(Args))
