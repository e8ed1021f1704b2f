"""Defenders × attacks × numbers of attackers on test scenes, on equal terms: one table with error bars and costs.

    python examples/benchmark.py --small                                        # a few minutes; what `make demo` runs
    python examples/benchmark.py --ks 1 2 3 4 --seeds 0 1 2 --workers 2 --out out/benchmark

Defenders and attacks are names, with options if need be: `prbi:threshold=calibrated`, `pgd:steps=30`; a learned
attack is `policy:name=prbi-0`, or a file of yours; a class of yours is `module:Class`. The same command goes on where
a killed run stopped. For more axes, worst cases and a page that shows them: `cp-arena`.
"""

from __future__ import annotations

import shlex
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import torch
import tyro
from rich.console import Console

from agents.arena import Bars, CommonOptions, make_attack
from agents.arena.progress import run_label
from cp_env import evaluation
from cp_env.evaluation.report.benchmark import GLOSSARY
from cp_env.evaluation.report.video import render_episode
from cp_env.rendering.frame import Image3, write_gif
from cp_env.settings import Fusion


@dataclass(frozen=True)
class Args(CommonOptions):
    """Defenders × attacks × numbers of attackers on test scenes."""

    defenders: tuple[str, ...] = ("none", "ego_only", "prbi", "prbi:threshold=calibrated", "oracle")
    attacks: tuple[str, ...] = ("none", "pgd")
    ks: tuple[int, ...] = (1, 2, 3, 4)  # attackers among `vehicles`
    seeds: tuple[int, ...] = (0,)
    fusion: Fusion = "mean"
    budget: float = 0.3  # Δ
    workers: int = 1  # processes
    out: Path = Path("out/benchmark")
    gif: bool = True  # also make a video of one episode of the first scene
    small: bool = False  # three scenes, 30 frames, k = 2

    def cut(self) -> Args:
        """Itself, or the small cut."""
        return replace(self, n_scenes=3, frames=30, ks=(2,), batch=3) if self.small else self


def main(args: Args) -> None:
    console = Console()
    torch.set_num_threads(args.threads)
    conditions = args.on_scenes(budget=args.budget, fusion=args.fusion)
    runs = evaluation.plan_runs(
        conditions,
        defenders=args.defenders,
        attacks=args.attacks,
        ks=args.ks,
        seeds=args.seeds,
        batch=args.batch,
    )
    workers = evaluation.Workers(make_attack=make_attack, processes=args.workers, threads=args.threads)
    store = evaluation.Store(args.out, evaluation.open_bank(conditions).detector.digest)
    with Bars(console) as bars:
        bars.count("opening", evaluation.prepare(runs, conditions, workers), len(conditions.names))
        bars.count("playing", evaluation.execute(runs, conditions, store, workers), len(runs), run_label)
    rows = evaluation.summarise(store.load(runs, conditions))
    command = shlex.join(["python", *sys.argv])
    paths = evaluation.write_report(
        args.out,
        rows,
        evaluation.about(conditions, command, seeds=args.seeds, workers=args.workers, threads=args.threads),
    )
    size = f"{len(conditions.names)} scenes, {conditions.frames} frames, {conditions.n_vehicles} vehicles"
    console.print(
        evaluation.screen(rows), f"{size}; means (intervals are in the files)", GLOSSARY, sep="\n", highlight=False
    )
    console.print("written:", *paths)
    if args.gif:
        console.print("video:  ", write_gif(first_episode(args, conditions), args.out / "episode.gif"))


def first_episode(args: Args, conditions: evaluation.Conditions) -> list[Image3]:
    """One episode of PRBI (if it plays) against the last attack."""
    defender = next((name for name in args.defenders if name.startswith("prbi")), args.defenders[-1])
    k = min(max(args.ks), 2)
    run = evaluation.Run(defender, args.attacks[-1], k, args.seeds[0], conditions.names[:1])
    return render_episode(run, conditions, evaluation.open_bank(conditions), make_attack)


if __name__ == "__main__":
    main(tyro.cli(Args).cut())
