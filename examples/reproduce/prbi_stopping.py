"""Convergence of PRBI under the published stopping rule and the corrected one, for all fleets up to 20 and all k < n.

    python examples/reproduce/prbi_stopping.py            # frames to convergence, a line for each n and k
    python examples/reproduce/prbi_stopping.py --why      # why the published rule often does not stop, with a picture

The verifier is perfect. Of `prbi` the table has the share of the runs that stop within --frames, and of those the share
in which exactly the attackers are flagged. Of `robust_prbi` it has the mean and most frames, and that share of all
runs. docs/prbi.md explains what --why shows.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import tyro
from rich.console import Console
from rich.progress import track
from rich.table import Table

from cp_env.rendering import style
from defenders import Prbi, RobustPrbi
from defenders.prbi.inference import upper_quantile
from defenders.simulation.statistics import play_many
from defenders.simulation.world import Scenario, SimulatedWorld


@dataclass
class Args:
    vehicles: tuple[int, ...] = tuple(range(2, 21))
    seeds: int = 3
    """runs of every n and k"""
    frames: int = 200
    """after which the published rule is given up"""
    why: bool = False
    window: int = 10
    alpha: float = 0.01
    n: int = 10
    """of the picture"""
    k: int = 4
    seed: int = 2
    out: Path = Path("out/prbi")


def grid(args: Args) -> None:
    table = Table("n", "k", "prbi: stops %", "of those right %", "robust_prbi: frames", "most", "right %")
    rows, shares = [], []
    jobs = [(n, k) for n in args.vehicles for k in range(1, n)]
    for n, k in track(jobs, "playing", transient=True):
        scenario = Scenario(n_vehicles=n, n_attackers=k, max_frames=args.frames)
        published = Prbi(window=args.window, alpha=args.alpha)
        paper = play_many(published, scenario, episodes=args.seeds, seed=0)
        robust = play_many(RobustPrbi(), scenario, episodes=args.seeds, seed=0)
        stops, right = (
            float(paper.converged.mean()),
            float(robust.exact_identification[robust.converged].sum() / args.seeds),
        )
        sound = float(paper.exact_identification[paper.converged].mean()) if stops else None
        rows.append(
            {"n": n, "k": k, "paper_stops": stops, "paper_right": sound, "robust_right": right}
            | {"robust_mean": float(robust.frames.mean()), "robust_most": int(robust.frames.max())}
        )
        shares.append((float(robust.frames.max() / n), right, f"n = {n}, k = {k}"))
        shown = "–" if sound is None else f"{100 * sound:.0f}"
        figures = [f"{robust.frames.mean():.1f}", str(robust.frames.max()), f"{100 * right:.0f}"]
        table.add_row(str(n), str(k), f"{100 * stops:.0f}", shown, *figures, end_section=k == n - 1)
    Console(width=100).print(table)
    most, _, where = max(shares)
    print(f"robust_prbi: right in {100 * np.mean([right for _, right, _ in shares]):.1f} % of the runs; ", end="")
    print(f"never more than {most:.2f} n frames ({where})")
    write(args.out / "stopping.json", {"args": vars(args), "rows": rows})


def why(args: Args) -> None:
    """Eq. (14) for a ramp of w values, and for m once the ranking is right."""
    table = Table(
        "w", "t of a ramp", "t(α/2)", "a ramp is", title=f"Eq. (14) on w equally spaced values, α = {args.alpha}"
    )
    for w in range(2, 13):
        statistic, most = (w - 1) * 3**0.5 / (w + 1) ** 0.5, upper_quantile(args.alpha, w - 1)
        table.add_row(str(w), f"{statistic:.2f}", f"{most:.2f}", "accepted" if statistic <= most else "rejected")
    Console().print(table)
    m, zeros, statistic = trace(args)
    quantile = upper_quantile(args.alpha, args.window - 1)
    second = np.floor(m) == zeros
    ranked = int(np.flatnonzero(zeros != args.k)[-1]) + 1 if (zeros != args.k).any() else 0
    late = slice(ranked + args.window, None)
    accepted = second[late] & (statistic[late] <= quantile)
    print(
        f"n = {args.n}, k = {args.k}, w = {args.window}: exactly the attackers are at zero from frame {ranked + 1} on."
    )
    print(f"Then, with a full window, ⌊m⌋ = k in {second[late].sum()} of {len(m[late])} frames,", end=" ")
    print(f"and t <= {quantile:.2f} in {accepted.sum()} of those.")
    draw(args, m, second, statistic, quantile)


def trace(args: Args) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """m, vehicles of probability zero, and t of Eq. (14), after each abnormal frame of a run that never stops."""
    defender = Prbi(stopping="never", window=args.window, alpha=args.alpha)
    world = SimulatedWorld(args.n, frozenset(range(args.k)))
    defender.reset(args.n, np.random.default_rng(args.seed))
    world.judge(defender, attack=False)
    rows = []
    for _ in range(args.frames):
        world.judge(defender)
        window = np.array(defender.history)
        spread = window.std(ddof=1) / len(window) ** 0.5 if len(window) > 1 else 0.0
        t = abs(window.mean() - defender.m) / spread if spread else 0.0
        rows.append((defender.m, np.count_nonzero(defender.probability == 0), t))
    m, zeros, t = np.array(rows).T
    return m, zeros, t


@style.plot_style()
def draw(args: Args, m: np.ndarray, second: np.ndarray, statistic: np.ndarray, quantile: float) -> None:
    figure, (top, bottom) = plt.subplots(2, 1, figsize=(style.PAGE, 4.4), sharex=True, layout="constrained")
    frame = np.arange(1, len(m) + 1)
    top.plot(frame, m, marker=".", markersize=3, color=style.BLUE, label="m, Eq. (9)")
    top.axhline(args.k, color=style.GREY, linewidth=1, label=f"k = {args.k}")
    mark: dict[str, Any] = {"fillstyle": "none", "color": style.VERMILLION}
    top.plot(frame[second], m[second], "o", label="⌊m⌋ = vehicles of probability zero", **mark)
    top.set_ylabel("estimated attackers m")
    top.set_ylim(args.k - 1.5, args.k + 1.0)
    bottom.plot(frame, statistic, marker=".", markersize=3, color=style.BLUE, label="|mean of W − m| / (S / √w)")
    bottom.plot(frame[second], statistic[second], "o", **mark)
    bottom.axhline(quantile, color="black", linestyle="--", label=f"accepted below t = {quantile:.2f}")
    bottom.set_ylabel("statistic of Eq. (14)")
    bottom.set_xlabel("abnormal frames")
    for axis in (top, bottom):
        axis.legend(loc="upper right", ncols=3, fontsize="small")
    bottom.set_ylim(0, 1.25 * max(statistic.max(), quantile))
    figure.suptitle(
        f"Why the published rule does not stop: n = {args.n}, k = {args.k}, w = {args.window}, α = {args.alpha}"
    )
    args.out.mkdir(parents=True, exist_ok=True)
    style.save_plot(figure, args.out / "stopping.png")
    plt.close(figure)
    print("written:", args.out / "stopping.png")


def write(path: Path, data: object) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(data, default=str, indent=1) + "\n")
    print("written:", path)


def main(args: Args) -> None:
    why(args) if args.why else grid(args)


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
