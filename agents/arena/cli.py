"""`cp-arena`: attacks × defenders × fusions × Δ × k × seeds, and the worst case of each, as one page.

    cp-arena                                                    # all that is known by name, on all cores
    cp-arena --ks 2 1 3 4 --budgets 0.3 0.1 0.5 --off-baseline-scenes 3 --off-baseline-attacks pgd
    cp-arena --defenders prbi mine:Halves --attacks pgd:steps=30 policy:name=prbi-0 mine:Whisper:level=0.5
    cp-arena --screen town/calibration --n-scenes 21            # each defender's attack is picked on other scenes
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
from agents.arena.conditions import CommonOptions, check_calibration, spread
from agents.arena.entries import make_attack
from agents.arena.progress import Bars, announce, examined, run_label
from cp_env import evaluation
from cp_env.evaluation.analysis.measures import measure_of
from cp_env.evaluation.analysis.results import ArenaResults, collect_results, with_videos, write_json
from cp_env.evaluation.execution.ray import joined
from cp_env.evaluation.plan.grid import Axes, Grid, Job, jobs_of
from cp_env.evaluation.report.arena import draw_plots, write_html, write_markdown
from cp_env.evaluation.report.leaderboard import write_leaderboard
from cp_env.evaluation.report.video import render_videos
from cp_env.paths import use_current_folder
from cp_env.scenes import open_source
from cp_env.settings import Fusion, Norm
from cp_env.world.allocator import keep_freed_memory


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
    rank_by: tuple[str, ...] = ("damage", "critical_recall")  # the measure that ranks, and further ones
    screen: str | None = None  # scenes on which each defender's worst attack is picked, such as town/calibration
    screen_scenes: int | None = None  # so many of them, spread evenly (all by default)
    norm: Norm = "linf"  # of Δ
    grace_frames: int = 1  # benign frames at the start; with 0 the very first may be poisoned
    workers: int = os.cpu_count() or 1  # processes
    ray: tuple[str, ...] | None = None  # on a Ray cluster instead of `workers`; its address, or none for the one here
    videos: bool = True  # a video of each defender's worst episode
    out: Path = Path("out/arena")
    page: Path | None = None  # also write a leaderboard there (Markdown), with its plots in a folder of the same name


def main(argv: list[str] | None = None) -> None:
    """Run the console script; `argv` are the command line's unless given."""
    use_current_folder()
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
    keep_freed_memory()
    grids = plan(args)
    screening = plan_screening(args, grids[0])
    played = grids if screening is None else [*grids, screening]
    workers = evaluation.Workers(
        make_attack=make_attack,
        processes=args.workers,
        threads=args.threads,
        ray=None if args.ray is None else "".join(args.ray),
    )
    with Bars(console) as bars, nullcontext() if workers.ray is None else joined(workers.ray):
        for source in [grids] if screening is None else [grids, [screening]]:
            _open(source, workers, bars)
        jobs, failed = jobs_of(played), ""
        _announce(args, jobs)
        try:
            bars.count("playing", evaluation.execute_all(jobs, workers), len(jobs), lambda job: run_label(job[0]))
        except evaluation.FailedRuns as error:
            failed = str(error)
        results = bars.during(
            "tables",
            lambda: collect_results(grids, args.out, failed=failed, rank_by=args.rank_by, screening=screening),
        )
        if args.videos:
            bars.count(
                "rendering",
                render_videos(results.worst, results.baseline.conditions, workers),
                len(results.worst),
                unit="video",
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


def plan_screening(args: Args, baseline: Grid) -> Grid | None:
    """The baseline on the scenes on which each defender's worst attack is picked; None without `--screen`.

    Raises:
        ValueError: an unknown measure, or scenes that are also reported on.
    """
    for name in args.rank_by:
        measure_of(name)
    if args.screen is None:
        return None
    elsewhere = replace(args, scenes=args.screen, n_scenes=args.screen_scenes)
    names = elsewhere.on_scenes().names
    same = open_source(args.screen).digest == open_source(args.scenes).digest
    shared = sorted(set(names) & set(baseline.conditions.names)) if same else []
    if shared:
        raise ValueError(f"attacks are screened on other scenes than those reported on; both hold {', '.join(shared)}")
    conditions = replace(baseline.conditions, scenes=args.screen, names=names)
    axes = Axes(
        defenders=args.defenders,
        attacks=args.attacks,
        fusions=args.fusions[:1],
        budgets=args.budgets[:1],
        ks=args.ks[:1],
        seeds=args.seeds,
        batch=args.batch,
    )
    return axes.grids(conditions, {args.fusions[0]: baseline.store})[0]


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
        rank_by=args.rank_by,
        screen="none" if args.screen is None else args.screen,
        workers="a Ray cluster" if args.ray is not None else args.workers,
        threads=args.threads,
        cores=os.cpu_count(),
    )


def _announce(args: Args, jobs: Sequence[Job]) -> None:
    """Say what is to be played, and of which defenders the calibration is another detector's."""
    processes = args.workers if args.ray is None else None
    who = "a Ray cluster" if processes is None else f"processes: {processes}"
    announce(examined(jobs), jobs[0][1], who, processes)
    if args.sealed:
        return  # entries are imported in processes of their own alone, and say it there
    for conditions in {conditions.fusion: conditions for _, conditions, _ in jobs}.values():
        check_calibration(args.defenders, evaluation.open_bank(conditions).detector, conditions.fusion)


def _open(grids: Sequence[Grid], workers: evaluation.Workers, bars: Bars) -> None:
    """Check every entry, and open every scene once for each fusion."""
    for fusion in dict.fromkeys(grid.conditions.fusion for grid in grids):
        mine = [grid for grid in grids if grid.conditions.fusion == fusion]
        names = tuple(dict.fromkeys(name for grid in mine for name in grid.conditions.names))
        conditions = replace(mine[0].conditions, names=names)
        runs = [run for grid in mine for run in grid.runs]
        bars.count("opening", evaluation.prepare(runs, conditions, workers), len(names), unit="scene")


if __name__ == "__main__":
    main()
