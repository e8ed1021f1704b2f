"""`cp-arena`: attackers × defenders × fusions × Δ × k × seeds, and the worst case of each, as one page.

    cp-arena                                                    # all that is known by name, on all cores
    cp-arena --ks 2 1 3 4 --budgets 0.3 0.1 0.5 --side-scenes 3 --side-attackers pgd
    cp-arena --defenders prbi mine:Halves --attackers pgd:steps=30 policy:name=prbi-0 mine:Whisper:level=0.5
    cp-arena --ray                                              # the cluster that runs here; --ray ray://head:10001

Entries are names, with knobs if need be; a learned attacker is `policy:name=…`; a class of yours, in a file that Python
finds from the current directory, is `module:Class`, with knobs `module:Class:knob=value`. Whatever ends a run, the same
command goes on with it. `arena.html` in `out` opens in any browser, without a network.
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
from agents.arena.conditions import Conditions, spread
from agents.arena.entries import make_attacker
from agents.arena.progress import Bars, duel
from cp_env import evaluation
from cp_env.evaluation.analysis.results import Findings, find, with_films, write_json
from cp_env.evaluation.execution.ray import joined
from cp_env.evaluation.execution.rollout import open_defender
from cp_env.evaluation.plan.grid import Axes, Board, turns_of
from cp_env.evaluation.report.arena import pictures, write_html, write_markdown
from cp_env.evaluation.report.leaderboard import write_leaderboard
from cp_env.evaluation.report.video import shoot


@dataclass(frozen=True)
class Args(Conditions):
    """Every defender against every attacker. The first fusion, Δ and k are the base, where the ranking is made."""

    defenders: tuple[str, ...] = defenders.names()
    attackers: tuple[str, ...] = agents.names()
    fusions: tuple[str, ...] = ("mean",)  # of mean, max, sum, v2vnet, disconet
    budgets: tuple[float, ...] = (0.3,)  # Δ
    ks: tuple[int, ...] = (2,)  # liars among `vehicles`
    seeds: tuple[int, ...] = (0,)
    design: str = "star"  # one axis at a time around the base, or "full": every combination
    side_scenes: int | None = None  # so many scenes away from the base (as many as there by default)
    side_attackers: tuple[str, ...] = ()  # those that play away from the base (all by default)
    norm: str = "linf"  # of Δ; or l2
    rsu: bool = False  # with the road-side unit's map
    grace_frames: int = 1  # honest frames at the start; with 0 the very first may be poisoned
    workers: int = os.cpu_count() or 1  # processes
    ray: tuple[str, ...] | None = None  # on a Ray cluster instead of `workers`; its address, or none for the one here
    films: bool = True  # film each defender's worst episode
    out: Path = Path("out/arena")
    page: Path | None = None  # also write a leaderboard there (Markdown), with its pictures in a folder beside it


def main(argv: list[str] | None = None) -> None:
    """What the console script calls; `argv` are the command line's unless given."""
    if os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())  # where outsiders' classes are
    args = tyro.cli(Args, args=argv, description=__doc__)
    command = shlex.join(["cp-arena", *(sys.argv[1:] if argv is None else argv)])
    try:
        found = play(args, command, Console())
    except (ValueError, ImportError) as error:
        raise SystemExit(f"cp-arena: {error}") from error
    if found.failed:
        raise SystemExit(f"cp-arena: {found.failed}")


def play(args: Args, command: str, console: Console) -> Findings:
    """Play what is not stored yet, write all reports, and return what was found."""
    torch.set_num_threads(args.threads)
    boards = plan(args)
    crew = evaluation.Crew(
        make_attacker=make_attacker,
        workers=args.workers,
        threads=args.threads,
        ray=None if args.ray is None else "".join(args.ray),
    )
    with Bars(console) as bars, nullcontext() if crew.ray is None else joined(crew.ray):
        _encode(boards, crew, bars)
        turns, failed = turns_of(boards), ""
        try:
            bars.count("playing", evaluation.run_all(turns, crew), len(turns), lambda turn: duel(turn[0]))
        except evaluation.FailedCells as error:
            failed = str(error)
        told = [spec for spec in args.defenders if hasattr(open_defender(spec), "tell")]
        found = find(boards, args.out, told=told, failed=failed)
        if args.films:
            bars.count("filming", shoot(found.worst, found.base.protocol, crew), len(found.worst))
    found = with_films(found)
    about = conditions(args, found, command)
    drawn = pictures(found)
    paths = [write_html(found, drawn, args.out, about), write_markdown(found, args.out / "arena.md", about)]
    paths += write_json(found, args.out, about)[:1]
    if args.page is not None:
        paths.append(write_leaderboard(found, drawn, args.page, about))
    console.print("written:", *paths, soft_wrap=True)
    return found


def plan(args: Args) -> list[Board]:
    """The boards of the run. ValueError for what cannot be played."""
    protocol = args.on_scenes(
        budget=args.budgets[0] if args.budgets else 0.0,
        norm=args.norm,
        rsu=args.rsu,
        grace_frames=args.grace_frames,
    )
    axes = Axes(
        defenders=args.defenders,
        attacks=args.attackers,
        fusions=args.fusions,
        budgets=args.budgets,
        ks=args.ks,
        seeds=args.seeds,
        design=args.design,
        side_attacks=args.side_attackers,
        side_names=() if args.side_scenes is None else spread(protocol.names, args.side_scenes),
        batch=args.batch,
    )
    detectors = {f: evaluation.open_bank(replace(protocol, fusion=f)).detector for f in args.fusions}
    return axes.boards(protocol, {f: evaluation.Store(args.out, eyes.digest) for f, eyes in detectors.items()})


def conditions(args: Args, found: Findings, command: str) -> dict[str, Any]:
    """All that the figures depend on, and where they were made."""
    return evaluation.about(
        found.base.protocol,
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


def _encode(boards: Sequence[Board], crew: evaluation.Crew, bars: Bars) -> None:
    """Check every entry, and encode every scene once for each fusion."""
    for fusion in dict.fromkeys(board.protocol.fusion for board in boards):
        mine = [board for board in boards if board.protocol.fusion == fusion]
        names = tuple(dict.fromkeys(name for board in mine for name in board.protocol.names))
        protocol = replace(mine[0].protocol, names=names)
        cells = [cell for board in mine for cell in board.cells]
        bars.count("encoding", evaluation.prepare(cells, protocol, crew), len(names))


if __name__ == "__main__":
    main()
