"""Similarity of a group's view to the frame before, by the size of the group and the number of attackers in it.

    python examples/reproduce/similarity_table.py                           # measure, print, draw
    python examples/reproduce/similarity_table.py --frames 4 --fusion max

PRBI (Sec. 11.1) judges every group by one threshold, 0.35. Here the similarity, Eq. (5), of every group of five
vehicles to the benign view of the frame before is measured on the calibration scenes. PGD attacks jointly in k = 0 … 4
vehicles (Δ 0.3, 15 steps of 0.1). The threshold of a size is the one that errs least: it minimises the mean of the
share of benign groups that fail and the share of groups with an attacker that pass. The latter is averaged over the
numbers of attackers, so that each number has the same weight. `cp-calibrate` measures the same and writes the
thresholds where defenders find them; see `agents.calibration.previous_frame`.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import torch
import tyro
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from rich.console import Console
from rich.table import Table

from agents.arena.conditions import spread
from agents.calibration.previous_frame import survey, thresholds
from agents.calibration.samples import Samples, pooled
from agents.commands.common import Victim
from cp_env.metrics.intervals import Interval
from cp_env.metrics.shares import share_interval
from cp_env.progress import track
from cp_env.rendering import style
from cp_env.scenes import open_source
from cp_env.world.scene_cache import SceneBank

PAPER = 0.35
"""The paper's threshold for groups of all sizes."""


@dataclass(frozen=True)
class Args(Victim):
    scenes: str = "town/calibration+junction/calibration"
    n_scenes: int | None = None  # so many of them, spread evenly (all by default)
    n_vehicles: int = 5
    frames: int = 11  # of every scene; the first is the reference of the second
    attack: str = "pgd"
    seed: int = 0
    threads: int = 1
    out: Path = Path("out/similarity")


def report(found: Samples, epsilon: dict[int, float], args: Args) -> None:
    sizes = range(1, args.n_vehicles + 1)
    table = Table(
        "group size",
        *(f"{k} attackers" for k in range(args.n_vehicles)),
        "ε",
        title=f"{args.fusion}: similarity to the frame before",
    )
    shares = Table(
        "group size", *(f"{k} attackers" for k in range(args.n_vehicles)), title="share that passes at 0.35 / at ε"
    )
    rows = []
    for size in sizes:
        cells, passing = [], []
        for attackers in range(args.n_vehicles):
            if (size, attackers) not in found:
                cells.append("–")
                passing.append("–")
                continue
            mean: Interval = share_interval([np.mean(values) for values in found[size, attackers].values()])
            values = pooled(found, (size, attackers))
            cells.append(f"{mean:.2f}")
            passing.append(f"{(values >= PAPER).mean():.2f} / {(values >= epsilon[size]).mean():.2f}")
            rows.append({"size": size, "attackers": attackers, "mean": mean.mean, "low": mean.low, "high": mean.high})
        table.add_row(str(size), *cells, f"{epsilon[size]:.2f}")
        shares.add_row(str(size), *passing)
    console = Console(width=150)
    console.print(table, shares, sep="\n")
    args.out.mkdir(parents=True, exist_ok=True)
    path = args.out / f"{args.fusion}.json"
    path.write_text(json.dumps({"rows": rows, "epsilon": epsilon}, indent=1) + "\n")
    console.print("drawn:", draw(found, epsilon, args))


@style.plot_style()
def draw(found: Samples, epsilon: dict[int, float], args: Args) -> Path:
    """Histograms by size of the group. An axis of square roots shows the benign groups beside the peak near 0."""
    rows = -(-(args.n_vehicles + 1) // 3)  # the last panel is the legend's
    figure = plt.figure(figsize=(style.PAGE, 0.5 + 2.1 * rows), layout="constrained")
    axes = figure.subplots(rows, 3, sharex=True, sharey=True, squeeze=False).flat
    panels, rest = axes[: args.n_vehicles], axes[args.n_vehicles :]
    colours = [style.BLUE, *style.attacker_colours(args.n_vehicles - 1)]
    for size, axis in enumerate(panels, start=1):
        for attackers in range(args.n_vehicles):
            if (size, attackers) not in found:
                continue
            values = pooled(found, (size, attackers))
            share = np.full(len(values), 1 / len(values))
            drawn: dict[str, Any] = {"color": colours[attackers], "bins": np.linspace(0, 1, 26), "weights": share}
            if attackers == 0:
                axis.hist(values, alpha=0.3, **drawn)
            axis.hist(values, histtype="step", lw=1.6, **drawn)
        axis.axvline(PAPER, color=style.GREY, ls=":")
        axis.axvline(epsilon[size], color=style.BLACK, ls="--", lw=1.2)
        axis.set_title("single vehicles" if size == 1 else f"groups of {size}")
        style.share_axis(axis)
    for axis in rest:
        axis.set_axis_off()
    for axis in panels[-3:]:
        axis.tick_params(labelbottom=True)
    figure.supxlabel("Jaccard similarity to the benign view of the frame before", fontsize=9)
    figure.supylabel("share of the groups (square-root axis)", fontsize=9)
    handles: list[Any] = [Patch(color=colours[0], alpha=0.5, label="no attacker")]
    for number, colour in enumerate(colours[1:], start=1):
        handles.append(Line2D([], [], color=colour, label=f"{number} attacker{'s' if number > 1 else ''}"))
    handles.append(Line2D([], [], color=style.GREY, ls=":", label=f"{PAPER} (paper)"))
    handles.append(Line2D([], [], color=style.BLACK, ls="--", lw=1.2, label="ε, calibrated for the size"))
    rest[0].legend(handles=handles, loc="center", fontsize=9)
    path = style.save_plot(figure, args.out / f"{args.fusion}.png")
    plt.close(figure)
    return path


def main(args: Args) -> None:
    torch.set_num_threads(args.threads)
    bank = SceneBank(open_source(args.scenes), args.open_detector())
    found = survey(
        bank,
        spread(bank.source.names(), args.n_scenes),
        n_vehicles=args.n_vehicles,
        frames=args.frames,
        attack=args.attack,
        seed=args.seed,
        track=track,
    )
    report(found, thresholds(found, args.n_vehicles), args)


if __name__ == "__main__":
    main(tyro.cli(Args))
