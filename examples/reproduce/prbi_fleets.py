"""PRBI's Fig. 4: how m converges in fleets of 6 to 20 vehicles, with a fixed number and a fixed share of attackers.

    python examples/reproduce/prbi_fleets.py

The verifier is perfect, and PRBI goes on verifying. "ranked" is the abnormal frame from which on exactly the attackers
have probability zero. "close" is the one from which on |m - k| < 0.5. Both are medians over runs, with the range, and
"–" if the median run does not reach it within --frames. The paper names neither its k nor its shares. Its m converges
in about 100 frames at n = 15 and 500 at n = 20 with a fixed share, and more slowly for larger n with a fixed k.
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

from cp_env.rendering import style
from defenders import Prbi
from defenders.simulation.world import SimulatedWorld


@dataclass
class Args:
    vehicles: tuple[int, ...] = (6, 8, 10, 12, 15, 20)
    fixed: tuple[int, int] = (2, 4)
    """numbers of attackers"""
    shares: tuple[float, float] = (0.3, 0.4)
    """of the vehicles, rounded to the nearest number"""
    frames: int = 1000
    runs: int = 3
    """of each fleet; the first is drawn"""
    seed: int = 0
    out: Path = Path("out/prbi")


@dataclass(frozen=True)
class Row:
    panel: str
    n: int
    k: int
    ranked: list[float]  # a value a run; infinite if not within the frames
    close: list[float]
    m: list[float]  # of the first run


def watch(n: int, k: int, seed: int, frames: int) -> tuple[np.ndarray, np.ndarray]:
    """m, and whether exactly the attackers have probability zero, after each abnormal frame."""
    defender, world = Prbi(stopping="never"), SimulatedWorld(n, frozenset(range(k)))
    defender.reset(n, np.random.default_rng(seed))
    world.judge(defender, attack=False)
    m, right = np.empty(frames), np.empty(frames, dtype=bool)
    for i in range(frames):
        world.judge(defender)
        m[i] = defender.m
        right[i] = ((defender.probability == 0) == (np.arange(n) < k)).all()
    return m, right


def since(holds: np.ndarray) -> float:
    """The frame, from 1, from which on something holds to the end; infinite if it does not hold then."""
    broken = np.flatnonzero(~holds)
    last = int(broken[-1]) + 1 if len(broken) else 0
    return float(last + 1) if last < len(holds) else math.inf


def measure(args: Args, panel: str, n: int, k: int) -> Row:
    runs = [watch(n, k, args.seed + i, args.frames) for i in range(args.runs)]
    ranked = [since(right) for _, right in runs]
    close = [since(abs(m - k) < 0.5) for m, _ in runs]
    return Row(panel, n, k, ranked, close, runs[0][0].tolist())


def spread(values: list[float]) -> str:
    shown = [f"{x:.0f}" if math.isfinite(x) else "–" for x in (np.median(values), min(values), max(values))]
    return f"{shown[0]} ({shown[1]} … {shown[2]})"


@style.plot_style()
def draw(rows: list[Row], args: Args) -> None:
    panels = list(dict.fromkeys(row.panel for row in rows))
    figure, axes = plt.subplots(2, 2, figsize=(style.PAGE, 5.6), sharex=True, layout="constrained")
    for axis, panel in zip(axes.flat, panels, strict=True):
        for i, row in enumerate(row for row in rows if row.panel == panel):
            axis.plot(range(1, args.frames + 1), row.m, color=f"C{i}", linewidth=1, label=f"n = {row.n}, k = {row.k}")
            axis.axhline(row.k, color=f"C{i}", linestyle=":", linewidth=0.8)
        axis.set(title=panel, xscale="log", ylabel="estimated attackers m, Eq. (9)")
        axis.legend(fontsize=7.5, ncols=2, loc="upper right", labelspacing=0.2, columnspacing=0.8, handlelength=1)
        axis.set_ylim(0, 1.45 * max(max(row.m[1:]) for row in rows if row.panel == panel))
    for axis in axes[1]:
        axis.set_xlabel("abnormal frames")
    figure.suptitle("m in fleets of 6 to 20 vehicles, perfect verifier (dotted: k)")
    style.save_plot(figure, args.out / "fleets.png")
    plt.close(figure)


def main(args: Args) -> None:
    jobs = [(f"k = {k}", n, k) for k in args.fixed for n in args.vehicles if k < n]
    jobs += [(f"k = {share:g} n", n, max(round(share * n), 1)) for share in args.shares for n in args.vehicles]
    rows = [measure(args, *job) for job in track(jobs, "playing", transient=True)]
    table = Table(
        "", "n", "k", "ranked", "close", title=f"Fig. 4, {args.runs} runs of {args.frames} abnormal frames a row"
    )
    for row in rows:
        last = row.n == args.vehicles[-1]
        table.add_row(row.panel, str(row.n), str(row.k), spread(row.ranked), spread(row.close), end_section=last)
    Console(width=100).print(table)
    args.out.mkdir(parents=True, exist_ok=True)
    data = {"args": vars(args), "rows": [asdict(row) for row in rows]}
    (args.out / "fleets.json").write_text(json.dumps(data, default=str) + "\n")
    draw(rows, args)
    print("written:", args.out / "fleets.json", args.out / "fleets.png")


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
