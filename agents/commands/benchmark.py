"""Defenders × attacks × numbers of attackers on test scenes, on equal terms: one table with error bars and costs.

    cp-benchmark --small                                                        # a few minutes; what `make demo` runs
    cp-benchmark --ks 1 2 3 4 --seeds 0 1 2 --workers 2 --out out/benchmark
    cp-benchmark --scenes mine:Folder:folder=data --weights runs/mine/mean.safetensors

Defenders and attacks are names, with options if need be: `prbi:threshold=calibrated`, `pgd:steps=30`; a learned
attack is `policy:name=prbi-0`, or a file of yours; a class of yours is `module:Class`. The same command goes on where
a killed run stopped. For more axes, worst cases and a page that shows them: `cp-arena`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from rich.console import Console

from agents.arena import Bars, CommonOptions, make_attack
from agents.arena.conditions import check_calibration
from agents.arena.progress import announce, examined, run_label
from agents.commands.common import run_program
from cp_env import evaluation
from cp_env.evaluation import Conditions, Run
from cp_env.evaluation.analysis.failed_episodes import failed_episodes
from cp_env.evaluation.report.benchmark import GLOSSARY
from cp_env.evaluation.report.video import record_episode, write_film
from cp_env.settings import Fusion

Results = dict[Run, tuple[evaluation.Record, ...]]


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


def plan(args: Args) -> tuple[Conditions, list[Run]]:
    """What is played, and under which conditions.

    Raises:
        ValueError: entries or conditions that cannot be played.
    """
    conditions = args.on_scenes(budget=args.budget, fusion=args.fusion)
    runs = evaluation.plan_runs(
        conditions,
        defenders=args.defenders,
        attacks=args.attacks,
        ks=args.ks,
        seeds=args.seeds,
        batch=args.batch,
    )
    return conditions, runs


def play(args: Args, conditions: Conditions, runs: Sequence[Run], console: Console) -> Results:
    """The episodes of all runs: those in `out`, and those that are missing there, which are played."""
    torch.set_num_threads(args.threads)
    workers = evaluation.Workers(make_attack=make_attack, processes=args.workers, threads=args.threads)
    detector = evaluation.open_bank(conditions).detector
    store = evaluation.Store(args.out, detector.digest)
    with Bars(console) as bars:
        bars.count("opening", evaluation.prepare(runs, conditions, workers), len(conditions.names), unit="scene")
        found = examined([(run, conditions, store) for run in runs])
        announce(found, conditions, f"processes: {args.workers}", args.workers)
        if not args.sealed:
            check_calibration(args.defenders, detector, args.fusion)
        bars.count("playing", evaluation.execute(runs, conditions, store, workers), len(runs), run_label)
    return store.load(runs, conditions)


def write(args: Args, conditions: Conditions, results: Results, command: str) -> tuple[Path, ...]:
    """The table as JSON and Markdown, with all that it depends on."""
    about = evaluation.about(conditions, command, seeds=args.seeds, workers=args.workers, threads=args.threads)
    return evaluation.write_report(
        args.out, evaluation.summarise(results), about, evaluation.strata(results), failed_episodes([results])
    )


def film(args: Args, conditions: Conditions) -> Path:
    """The video of one episode of PRBI (if it plays) against the last attack."""
    defender = next((name for name in args.defenders if name.startswith("prbi")), args.defenders[-1])
    k = min(max(args.ks), 2)
    run = Run(defender, args.attacks[-1], k, args.seeds[0], conditions.names[:1])
    pictures = record_episode(run, conditions, evaluation.open_bank(conditions), make_attack)
    return write_film(pictures, args.out / "episode.gif")


def program(args: Args, command: str) -> None:
    """Plan, play, write, and show."""
    args, console = args.cut(), Console()
    conditions, runs = plan(args)
    results = play(args, conditions, runs, console)
    paths = write(args, conditions, results, command)
    unit = " and the road-side unit" if conditions.rsu else ""
    size = f"{len(conditions.names)} scenes, {conditions.frames} frames, {conditions.n_vehicles} vehicles{unit}"
    console.print(
        evaluation.screen(evaluation.summarise(results)),
        f"{size}; means (intervals are in the files)",
        GLOSSARY,
        sep="\n",
        highlight=False,
    )
    console.print("written:", *paths, soft_wrap=True)
    if args.gif:
        console.print("video:  ", film(args, conditions), soft_wrap=True)


def main(argv: list[str] | None = None) -> None:
    """Run the console script; `argv` are the command line's unless given."""
    run_program("cp-benchmark", Args, program, __doc__, argv)


if __name__ == "__main__":
    main()
