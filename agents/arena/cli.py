"""`cp-arena`: attacks × defenders × fusions × Δ × k × seeds, and the worst case of each, as one page.

    cp-arena                                                    # all that is known by name, on all cores
    cp-arena --ks 2 1 3 4 --budgets 0.3 0.1 0.5 --off-baseline-scenes 3 --off-baseline-attacks pgd
    cp-arena --defenders prbi mine:Halves --attacks pgd:steps=30 policy:name=prbi-0 mine:Whisper:level=0.5
    cp-arena --ray                                              # the cluster that runs here; --ray ray://head:10001

Entries are names, with options if need be. A learned attack is `policy:name=…`. A class of yours, in a file that Python
finds from the current directory, is `module:Class`, with options `module:Class:option=value`. Whatever ends a run, the
same command goes on with it. `arena.html` in `out` opens in any browser, without a network.
"""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
import tyro
from rich.console import Console

import agents
import defenders
from agents.arena.conditions import CommonOptions, spread
from agents.arena.entries import make_attack
from agents.arena.progress import Bars, run_label
from cp_env import evaluation
from cp_env.evaluation.analysis.results import ArenaResults, collect_results, with_videos, write_json
from cp_env.evaluation.execution.ray import joined
from cp_env.evaluation.plan.grid import Axes, Grid, jobs_of
from cp_env.evaluation.report.arena import draw_plots, write_html, write_markdown
from cp_env.evaluation.report.leaderboard import write_leaderboard
from cp_env.evaluation.report.video import render_videos
from cp_env.settings import Fusion, Norm


@dataclass(frozen=True)
class Args(CommonOptions):
    """Every defender against every attack. The first fusion, Δ and k are the baseline, where the ranking is made."""

    defenders: tuple[str, ...] = defenders.names()
    attacks: tuple[str, ...] = agents.names()
    fusions: tuple[Fusion, ...] = ("mean",)
    budgets: tuple[float, ...] = (0.3,)  # Δ
    ks: tuple[int, ...] = (2,)  # attackers among `vehicles`
    seeds: tuple[int, ...] = (0,)
    design: str = "one-factor-at-a-time"  # one axis at a time around the baseline, or "full": every combination
    off_baseline_scenes: int | None = None  # so many scenes off the baseline (as many as there by default)
    off_baseline_attacks: tuple[str, ...] = ()  # attacks that play off the baseline (all by default)
    norm: Norm = "linf"  # of Δ
    rsu: bool = False  # with the road-side unit's map
    grace_frames: int = 1  # benign frames at the start; with 0 the very first may be poisoned
    workers: int = os.cpu_count() or 1  # processes
    ray: tuple[str, ...] | None = None  # on a Ray cluster instead of `workers`; its address, or none for the one here
    videos: bool = True  # a video of each defender's worst episode
    out: Path = Path("out/arena")
    page: Path | None = None  # also write a leaderboard there (Markdown), with its plots in a folder of the same name


def main(argv: list[str] | None = None) -> None:
    """Run the console script; `argv` are the command line's unless given."""
    if str(Path.cwd()) not in sys.path:
        sys.path.insert(0, str(Path.cwd()))  # where your own classes are
    args = tyro.cli(Args, args=argv, description=__doc__)
    command = shlex.join(["cp-arena", *(sys.argv[1:] if argv is None else argv)])
    try:
        results = play(args, command, Console())
    except (ValueError, ImportError) as error:
        raise SystemExit(f"cp-arena: {error}") from error
    if results.failed:
        raise SystemExit(f"cp-arena: {results.failed}")


def play(args: Args, command: str, console: Console) -> ArenaResults:
    """Play what is not stored yet, write all reports, and return the results."""
    torch.set_num_threads(args.threads)
    grids = plan(args)
    workers = evaluation.Workers(
        make_attack=make_attack,
        processes=args.workers,
        threads=args.threads,
        ray=None if args.ray is None else "".join(args.ray),
    )
    with Bars(console) as bars, nullcontext() if workers.ray is None else joined(workers.ray):
        _open(grids, workers, bars)
        jobs, failed = jobs_of(grids), ""
        try:
            bars.count("playing", evaluation.execute_all(jobs, workers), len(jobs), lambda job: run_label(job[0]))
        except evaluation.FailedRuns as error:
            failed = str(error)
        results = collect_results(grids, args.out, failed=failed)
        if args.videos:
            bars.count(
                "rendering", render_videos(results.worst, results.baseline.conditions, workers), len(results.worst)
            )
    results = with_videos(results)
    about = provenance(args, results, command)
    drawn = draw_plots(results)
    paths = [write_html(results, drawn, args.out, about), write_markdown(results, args.out / "arena.md", about)]
    paths += write_json(results, args.out, about)[:1]
    if args.page is not None:
        paths.append(write_leaderboard(results, drawn, args.page, about))
    console.print("written:", *paths, soft_wrap=True)
    return results


def plan(args: Args) -> list[Grid]:
    """The grids of the arena.

    Raises:
        ValueError: entries or conditions that cannot be played.
    """
    conditions = args.on_scenes(
        budget=args.budgets[0] if args.budgets else 0.0,
        norm=args.norm,
        rsu=args.rsu,
        grace_frames=args.grace_frames,
    )
    axes = Axes(
        defenders=args.defenders,
        attacks=args.attacks,
        fusions=args.fusions,
        budgets=args.budgets,
        ks=args.ks,
        seeds=args.seeds,
        design=args.design,
        off_baseline_attacks=args.off_baseline_attacks,
        off_baseline_names=()
        if args.off_baseline_scenes is None
        else spread(conditions.names, args.off_baseline_scenes),
        batch=args.batch,
    )
    detectors = {f: evaluation.open_bank(replace(conditions, fusion=f)).detector for f in args.fusions}
    return axes.grids(conditions, {f: evaluation.Store(args.out, detector.digest) for f, detector in detectors.items()})


def provenance(args: Args, results: ArenaResults, command: str) -> dict[str, Any]:
    """All that the results depend on, and where they were made."""
    return evaluation.about(
        results.baseline.conditions,
        command,
        fusions=args.fusions,
        budgets=args.budgets,
        ks=args.ks,
        seeds=args.seeds,
        design=args.design,
        workers="a Ray cluster" if args.ray is not None else args.workers,
        threads=args.threads,
        cores=os.cpu_count(),
    )


def _open(grids: Sequence[Grid], workers: evaluation.Workers, bars: Bars) -> None:
    """Check every entry, and open every scene once for each fusion."""
    for fusion in dict.fromkeys(grid.conditions.fusion for grid in grids):
        mine = [grid for grid in grids if grid.conditions.fusion == fusion]
        names = tuple(dict.fromkeys(name for grid in mine for name in grid.conditions.names))
        conditions = replace(mine[0].conditions, names=names)
        runs = [run for grid in mine for run in grid.runs]
        bars.count("opening", evaluation.prepare(runs, conditions, workers), len(names))


if __name__ == "__main__":
    main()
