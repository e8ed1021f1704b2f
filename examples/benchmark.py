"""Defenders × attacks × liars on test scenes, on equal terms: one table, error bars, cost counted by the referee.

    python examples/benchmark.py --small                                        # a few minutes; what `make demo` runs
    python examples/benchmark.py --ks 1 2 3 4 --seeds 0 1 2 --workers 2 --out out/benchmark

Defenders and attackers are names, with knobs if need be: `prbi:threshold=calibrated`, `pgd:steps=30`; a learned
attacker is `policy:name=prbi`, or a file of yours; a defender of yours is `package.module.Class`. The same command goes
on where a killed run stopped.
"""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import torch
import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

import agents
from agents.policy import load_policy
from cp_env import evaluation
from cp_env.evaluation.film import film
from cp_env.evaluation.report import GLOSSARY
from cp_env.rendering import Image3, write_gif
from cp_env.scenes import open_source

T = TypeVar("T")


@dataclass(frozen=True)
class Args:
    """Defenders × attacks × liars on test scenes."""

    scenes: str = "town/test"
    n_scenes: int | None = None  # play so many of them, spread evenly (all by default)
    frames: int = 100  # an episode's, five a second
    defenders: tuple[str, ...] = ("none", "ego_only", "prbi", "prbi:threshold=calibrated", "oracle")
    attackers: tuple[str, ...] = ("none", "pgd")
    ks: tuple[int, ...] = (1, 2, 3, 4)  # liars among `vehicles`
    seeds: tuple[int, ...] = (0,)
    vehicles: int = 5
    fusion: str = "mean"  # or max, sum, v2vnet, disconet
    weights: str | None = None  # a file of the detector's, such as `cp_env.detector.train` writes; else those that ship
    budget: float = 0.3  # Δ
    protocol: str = "strict"  # how AP is counted: "strict" or "coperception"
    batch: int = 4  # scenes in lock-step
    workers: int = 1  # processes
    threads: int = 1  # torch threads of each
    out: Path = Path("out/benchmark")
    gif: bool = True  # also film one episode of the first scene
    small: bool = False  # three scenes, 30 frames, k = 2

    def cut(self) -> Args:
        """Itself, or the small cut."""
        return replace(self, n_scenes=3, frames=30, ks=(2,), batch=3) if self.small else self


def main(args: Args) -> None:
    console = Console()
    torch.set_num_threads(args.threads)
    protocol = evaluation.Protocol(
        args.scenes,
        chosen(args),
        args.frames,
        args.vehicles,
        args.budget,
        fusion=args.fusion,
        ap=args.protocol,
        weights=args.weights,
    )
    cells = evaluation.plan(
        protocol,
        defenders=args.defenders,
        attacks=args.attackers,
        ks=args.ks,
        seeds=args.seeds,
        batch=args.batch,
    )
    crew = evaluation.Crew(make_attacker=attacker, workers=args.workers, threads=args.threads)
    store = evaluation.Store(args.out, evaluation.open_bank(protocol).detector.digest)
    with Progress(
        TextColumn("{task.description:<10}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[last]}"),
        console=console,
    ) as progress:
        for name in counted(progress, "encoding", evaluation.prepare(cells, protocol, crew), len(protocol.names)):
            progress.update(progress.task_ids[-1], last=name)
        for cell in counted(progress, "playing", evaluation.run(cells, protocol, store, crew), len(cells)):
            progress.update(progress.task_ids[-1], last=f"{cell.defender} against {cell.attack}, k = {cell.k}")
    rows = evaluation.summarise(store.load(cells, protocol))
    command = shlex.join(["python", *sys.argv])
    paths = evaluation.write_report(
        args.out,
        rows,
        evaluation.about(protocol, command, seeds=args.seeds, workers=args.workers, threads=args.threads),
    )
    size = f"{len(protocol.names)} scenes, {protocol.frames} frames, {protocol.n_vehicles} vehicles"
    console.print(
        evaluation.screen(rows), f"{size}; means (intervals are in the files)", GLOSSARY, sep="\n", highlight=False
    )
    console.print("written:", *paths)
    if args.gif:
        console.print("filmed: ", write_gif(filmed(args, protocol), args.out / "episode.gif"))


def attacker(name: str, **knobs: Any) -> evaluation.Attacker | evaluation.Learned:
    """A scripted attacker by its name, or a learned one as `policy:name=…`."""
    return load_policy(**knobs) if name == "policy" else agents.make(name, **knobs)


def chosen(args: Args) -> tuple[str, ...]:
    """The scenes to play: all, or `n_scenes` spread evenly over the source's list."""
    names = open_source(args.scenes).names()
    wanted = len(names) if args.n_scenes is None else args.n_scenes
    if not 1 <= wanted <= len(names):
        raise ValueError(f"n_scenes must be 1 to {len(names)}, not {wanted}")
    return tuple(names[i * len(names) // wanted] for i in range(wanted))


def counted(progress: Progress, what: str, steps: Iterator[T], total: int) -> Iterator[T]:
    """Draw a bar while `steps` are taken."""
    task = progress.add_task(what, total=total, last="")
    for step in steps:
        progress.advance(task)
        yield step


def filmed(args: Args, protocol: evaluation.Protocol) -> list[Image3]:
    """One episode of PRBI (if it plays) against the last attack."""
    defender = next((name for name in args.defenders if name.startswith("prbi")), args.defenders[-1])
    k = min(max(args.ks), 2)
    cell = evaluation.Cell(defender, args.attackers[-1], k, args.seeds[0], protocol.names[:1])
    return film(cell, protocol, evaluation.open_bank(protocol), attacker)


if __name__ == "__main__":
    main(tyro.cli(Args).cut())
