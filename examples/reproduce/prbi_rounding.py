"""PRBI's Fig. 3: the estimate m under three ways to round it, six vehicles, and the limits of Theorem 2.

    python examples/reproduce/prbi_rounding.py

The verifier is perfect, and PRBI goes on verifying. The limits of m are k (floor), k - 0.5 (nearest) and k - 1
(ceiling; log2(n / (n - 1)) = 0.263 at k = 1). "late" is the mean of m over the last third of the frames, with a 95 %
interval over runs. "away" is the largest |m - k| of any frame after the tenth (the paper: never above 2).
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import tyro
from rich.console import Console
from rich.progress import track
from rich.table import Table

from cp_env.metrics.intervals import Interval, t_interval
from cp_env.rendering import style
from defenders import Prbi
from defenders.prbi.interpretation import ROUNDINGS
from defenders.simulation.world import SimulatedWorld


@dataclass
class Args:
    n: int = 6
    frames: int = 300
    runs: int = 10
    """of each rounding and k; the first is drawn"""
    seed: int = 0
    out: Path = Path("out/prbi")


@dataclass(frozen=True)
class Row:
    rounding: str
    k: int
    limit: float  # of Theorem 2
    late: Interval
    away: float
    m: list[float]  # of the first run


def limit(rounding: str, n: int, k: int) -> float:
    """Theorem 2, from four vehicles on. η cannot exceed (n - k) / n, which makes its exception at k = 1."""
    return max(k - {"floor": 0.0, "nearest": 0.5, "ceiling": 1.0}[rounding], math.log2(n / (n - k)))


def watch(args: Args, rounding: str, k: int, seed: int) -> list[float]:
    """m after each abnormal frame."""
    defender, world = Prbi(stopping="never", rounding=rounding), SimulatedWorld(args.n, frozenset(range(k)))
    defender.reset(args.n, np.random.default_rng(seed))
    world.judge(defender, attack=False)
    values = []
    for _ in range(args.frames):
        world.judge(defender)
        values.append(defender.m)
    return values


def measure(args: Args, rounding: str, k: int) -> Row:
    runs = np.array([watch(args, rounding, k, args.seed + i) for i in range(args.runs)])
    late = t_interval(runs[:, -args.frames // 3 :].mean(axis=1))
    return Row(rounding, k, limit(rounding, args.n, k), late, float(abs(runs[:, 10:] - k).max()), runs[0].tolist())


@style.plot_style()
def draw(rows: list[Row], args: Args) -> None:
    figure, axes = plt.subplots(1, 3, figsize=(style.PAGE, 3.4), sharey=True, layout="constrained")
    for axis, rounding in zip(axes, ROUNDINGS, strict=True):
        for row in (row for row in rows if row.rounding == rounding):
            colour = style.attacker_colours(args.n - 1)[row.k - 1]
            axis.plot(range(1, args.frames + 1), row.m, color=colour, linewidth=1, label=f"m, k = {row.k}")
            axis.axhline(row.limit, color=colour, linestyle="--", linewidth=1)
        axis.set(title=rounding, xlabel="abnormal frames")
    axes[0].set_ylabel("estimated attackers m, Eq. (9)")
    axes[0].plot([], [], color=style.GREY, linestyle="--", linewidth=1, label="Theorem 2")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=args.n)
    axes[0].set_ylim(-0.2, args.n - 0.6)
    figure.suptitle(f"m under three roundings, n = {args.n}, perfect verifier")
    style.save_plot(figure, args.out / "rounding.png")
    plt.close(figure)


def main(args: Args) -> None:
    jobs = [(rounding, k) for rounding in ROUNDINGS for k in range(1, args.n)]
    rows = [measure(args, *job) for job in track(jobs, "playing", transient=True)]
    table = Table(
        "rounding", "k", "Theorem 2", "ours, late", "away", title=f"Fig. 3, n = {args.n}, {args.runs} runs a row"
    )
    for row in rows:
        table.add_row(row.rounding, str(row.k), f"{row.limit:.3f}", f"{row.late:.3f}", f"{row.away:.2f}")
    Console(width=100).print(table)
    args.out.mkdir(parents=True, exist_ok=True)
    data = {"args": vars(args), "rows": [asdict(row) for row in rows]}
    (args.out / "rounding.json").write_text(json.dumps(data, default=str, indent=1) + "\n")
    draw(rows, args)
    print("written:", args.out / "rounding.json", args.out / "rounding.png")


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
