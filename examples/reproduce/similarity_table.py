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

import matplotlib.pyplot as plt
import numpy as np
import torch
import tyro
from rich.console import Console
from rich.table import Table

from agents.arena.conditions import spread
from agents.calibration.previous_frame import survey, thresholds
from agents.calibration.samples import Samples, pooled
from agents.commands.common import Victim
from cp_env.metrics.intervals import Interval
from cp_env.metrics.shares import share_interval
from cp_env.progress import track
from cp_env.scenes import open_source
from cp_env.world.scene_cache import SceneBank


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
            passing.append(f"{(values >= 0.35).mean():.2f} / {(values >= epsilon[size]).mean():.2f}")
            rows.append({"size": size, "attackers": attackers, "mean": mean.mean, "low": mean.low, "high": mean.high})
        table.add_row(str(size), *cells, f"{epsilon[size]:.2f}")
        shares.add_row(str(size), *passing)
    console = Console(width=150)
    console.print(table, shares, sep="\n")
    args.out.mkdir(parents=True, exist_ok=True)
    path = args.out / f"{args.fusion}.json"
    path.write_text(json.dumps({"rows": rows, "epsilon": epsilon}, indent=1) + "\n")
    console.print("drawn:", draw(found, epsilon, args))


def draw(found: Samples, epsilon: dict[int, float], args: Args) -> Path:
    figure, axes = plt.subplots(
        1, args.n_vehicles, figsize=(3.2 * args.n_vehicles, 3.4), sharey=True, layout="constrained"
    )
    colours = plt.get_cmap("viridis")(np.linspace(0, 0.9, args.n_vehicles))
    for size, axis in enumerate(axes, start=1):
        for attackers in range(args.n_vehicles):
            if (size, attackers) in found:
                values, label = pooled(found, (size, attackers)), f"{attackers} attackers"
                axis.hist(
                    values,
                    np.linspace(0, 1, 26),
                    density=True,
                    histtype="step",
                    lw=1.8,
                    color=colours[attackers],
                    label=label,
                )
        axis.axvline(0.35, color="grey", ls=":", label="0.35 (paper)")
        axis.axvline(epsilon[size], color="crimson", ls="--", label="calibrated ε")
        axis.set(title=f"groups of {size}", xlabel="Jaccard similarity")
    axes[0].set_ylabel("density")
    axes[-1].legend(fontsize=8)
    path = args.out / f"{args.fusion}.png"
    figure.savefig(path, dpi=110)
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
