"""Frames until `bayes` is 99 % certain, and the information limit of any defender.

    python examples/reproduce/bayes_information_limit.py             # n = 5, 10, 15 and 20: a table and a picture
    python examples/reproduce/bayes_information_limit.py --n 5 --episodes 200

The verifier is perfect: it answers whether a group holds an attacker. k of n vehicles attack in every frame after a
benign one, and k is not known. There are 2^n sets of attackers, and a frame pays for two answers of one bit. So n / 2
frames are the limit under a uniform prior on sets. `bayes` has a uniform prior on the number of attackers. Under that a
set of k attackers holds log2(n C(n, k)) bits, which is less where k is near 0 or n. So fewer than n / 2 frames are
possible there.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from math import comb, log2
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import tyro
from rich.console import Console
from rich.progress import track
from rich.table import Table

from cp_env.metrics.intervals import Interval, t_interval
from cp_env.rendering import style
from defenders import Bayes
from defenders.simulation.world import Episode, play

LIMIT = "information limit: log2(n C(n, k)) / 2"


@dataclass
class Args:
    n: tuple[int, ...] = (5, 10, 15, 20)
    """vehicles"""
    episodes: int = 10
    """episodes for each number of attackers"""
    attackers: int = 5
    """numbers of attackers, spread over 1 … n - 1"""
    seed: int = 0
    out: Path = Path("out/bayes")


@dataclass(frozen=True)
class Row:
    n: int
    k: int
    frames: Interval
    exact: float  # share of episodes that ended with exactly the attackers flagged
    most: int  # verifications in a frame
    milliseconds: float  # of CPU time, a frame


def measure(args: Args, n: int, k: int) -> Row:
    start = time.process_time()
    played = [play(Bayes(likelihood="perfect"), n, k, args.seed + i, max_frames=100) for i in range(args.episodes)]
    spent = time.process_time() - start
    frames = [len(episode.results) for episode in played]
    return Row(
        n,
        k,
        t_interval(frames),
        float(np.mean([right(episode) for episode in played])),
        max(max(episode.verifications) for episode in played),
        1000 * spent / sum(frames),
    )


def right(episode: Episode) -> bool:
    return episode.converged and episode.suspects == episode.attackers


def counts(n: int, most: int) -> list[int]:
    """Numbers of attackers, spread over all that can be."""
    return sorted(set(np.linspace(1, n - 1, min(most, n - 1)).round().astype(int).tolist()))


@style.plot_style()
def draw(rows: list[Row], args: Args) -> Path:
    """A panel for each number of vehicles: what `bayes` takes, beside the information in the answers."""
    lines = -(-len(args.n) // 2)
    figure = plt.figure(figsize=(style.PAGE, 0.7 + 2.1 * lines), layout="constrained")
    axes = figure.subplots(lines, 2, squeeze=False).flat
    for n, axis in zip(args.n, axes, strict=False):
        mine = [row for row in rows if row.n == n]
        means = np.array([row.frames.mean for row in mine])
        reach = np.array([[row.frames.mean - row.frames.low, row.frames.high - row.frames.mean] for row in mine]).T
        every = np.arange(1, n)
        bits = [log2(n * comb(n, int(k))) for k in every]
        axis.plot(every, np.array(bits) / 2, color=style.BLACK, ls="--", lw=1.2, label=LIMIT)
        line: dict[str, Any] = {"color": style.DEFENDERS["bayes"], "capsize": 3, "ms": 5}
        axis.errorbar([row.k for row in mine], means, yerr=reach, fmt="o-", **line, label="bayes, to 99 % certainty")
        axis.set(title=f"{n} vehicles", xlabel="attackers", ylabel="frames of attack", ylim=(0, None))
        axis.xaxis.get_major_locator().set_params(integer=True)
    for axis in axes[len(args.n) :]:
        axis.set_axis_off()
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    path = style.save_plot(figure, args.out / "information_limit.png")
    plt.close(figure)
    return path


def main(args: Args) -> None:
    args.out.mkdir(parents=True, exist_ok=True)
    jobs = [(n, k) for n in args.n for k in counts(n, args.attackers)]
    rows = [measure(args, n, k) for n, k in track(jobs, "playing")]
    title = f"frames to 99 % certainty, perfect verifier, {args.episodes} episodes a row, 95 % intervals"
    table = Table("n", "k", "frames", "times n / 2", "exactly right %", "max. verifications", "ms a frame", title=title)
    for row in rows:
        spread = (row.frames.high - row.frames.low) / 2
        cells = (
            f"{row.frames.mean:.1f} ± {spread:.1f}",
            f"{row.frames.mean / (row.n / 2):.2f}",
            f"{100 * row.exact:.0f}",
        )
        table.add_row(str(row.n), str(row.k), *cells, str(row.most), f"{row.milliseconds:.0f}")
    for n in args.n:
        mean = float(np.mean([row.frames.mean for row in rows if row.n == n]))
        table.add_row(str(n), "all", f"{mean:.1f}", f"{mean / (n / 2):.2f}", "", "", "")
    console = Console(width=120)
    console.print(table)
    stored = [{"n": r.n, "k": r.k, "frames": r.frames.mean, "low": r.frames.low, "high": r.frames.high} for r in rows]
    (args.out / "information_limit.json").write_text(json.dumps(stored, indent=1) + "\n")
    console.print("drawn:", draw(rows, args))


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
