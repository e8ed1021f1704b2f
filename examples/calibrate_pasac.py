"""Scores of groups against the ego-only view: how well thresholds of ROBOSAC and PASAC separate, as tables and picture.

    python examples/calibrate_pasac.py                   # measure, print, draw
    python examples/calibrate_pasac.py --fusion max

ROBOSAC and PASAC compare the view of a group that contains the ego with the ego-only view. They compare the boxes by
their Jaccard similarity (published threshold 0.3), or the score maps by their consistency (CCLoss, published threshold
0.08, made for segmentation). Here both scores are measured on the calibration scenes. The ego is benign, and PGD
attacks jointly in k = 0 … n - 1 of the other vehicles (Δ 0.3, 15 steps of 0.1). `cp-calibrate` measures the same and
writes the thresholds where defenders find them; see `agents.calibration.ego_view`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import torch
import tyro
from rich.console import Console
from rich.table import Table

from agents.arena.conditions import spread
from agents.calibration.ego_view import survey, thresholds
from agents.calibration.samples import Samples, errors, pooled
from agents.commands.common import Victim
from cp_env.metrics.shares import share_interval
from cp_env.progress import track
from cp_env.rendering import style
from cp_env.scenes import open_source
from cp_env.world.scene_cache import SceneBank

PAPER = {"agreement": 0.08, "similarity": 0.3}


@dataclass(frozen=True)
class Args(Victim):
    scenes: str = "town/calibration+junction/calibration"
    n_scenes: int | None = None  # so many of them, spread evenly (all by default)
    n_vehicles: int = 5
    frames: int = 6  # of every scene, from a drawn one on
    attack: str = "pgd"
    seed: int = 0
    threads: int = 1
    out: Path = Path("out/pasac")


def table(score: str, found: Samples, epsilon: dict[int, float], args: Args) -> Table:
    attackers = range(args.n_vehicles)
    title = f"{args.fusion}: {score} to the ego-only view; errors: benign groups that fail / others that pass"
    shown = Table(
        "group", *(f"{k} attackers" for k in attackers), "ε", "errors at ε", f"errors at {PAPER[score]}", title=title
    )
    for size in sorted(epsilon):
        means = {k: [np.mean(x) for x in found[size, k].values()] for k in attackers if (size, k) in found}
        cells = [f"{share_interval(means[k]):.3f}" if k in means else "–" for k in attackers]
        rates = ["{:.2f} / {:.2f}".format(*errors(found, size, e, strict=True)) for e in (epsilon[size], PAPER[score])]
        shown.add_row(str(size), *cells, f"{epsilon[size]:.3f}", *rates)
    return shown


@style.plot_style()
def draw(found: dict[str, Samples], epsilon: dict[str, dict[int, float]], args: Args) -> Path:
    """Histograms by score and size of the group, on an axis of square roots."""
    sizes = range(2, args.n_vehicles + 1)
    figure, grid = plt.subplots(
        len(PAPER),
        len(sizes),
        figsize=(style.PAGE, 4.6),
        sharex="row",
        sharey=True,
        squeeze=False,
        layout="constrained",
    )
    colours = [style.BLUE, *style.attacker_colours(args.n_vehicles - 1)]
    for (score, by_key), row in zip(found.items(), grid, strict=True):
        edges = np.linspace(0, max(pooled(by_key, key).max() for key in by_key) * 1.02, 26)
        for size, axis in zip(sizes, row, strict=True):
            for k in range(args.n_vehicles):
                if (size, k) in by_key:
                    values = pooled(by_key, (size, k))
                    share, label = np.full(len(values), 1 / len(values)), f"{k} attackers"
                    axis.hist(values, edges, weights=share, histtype="step", lw=1.6, color=colours[k], label=label)
            axis.axvline(PAPER[score], color=style.GREY, ls=":", label="as published")
            axis.axvline(epsilon[score][size], color=style.BLACK, ls="--", lw=1.2, label="calibrated")
            axis.set(title=f"the ego and {size - 1} more", xlabel=score)
            style.share_axis(axis)
        row[0].set_ylabel("share of the groups")
    handles, labels = grid[-1, -1].get_legend_handles_labels()  # the panel that has every number of attackers
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
    path = style.save_plot(figure, args.out / f"ego_only-{args.fusion}.png")
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
    epsilon = {score: thresholds(samples, args.n_vehicles) for score, samples in found.items()}
    console = Console(width=170)
    console.print(*(table(score, found[score], epsilon[score], args) for score in PAPER), sep="\n")
    console.print("drawn:", str(draw(found, epsilon, args)))


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
