"""Defenders × attacks × liars on test scenes, on equal terms: one table, error bars, cost counted by the referee.

    python examples/benchmark.py --small                                        # a few minutes; what `make demo` runs
    python examples/benchmark.py --ks 1 2 3 4 --seeds 0 1 2 --workers 2 --out out/benchmark

Defenders and attackers are names, with knobs if need be: `prbi:threshold=calibrated`, `pgd:steps=30`; a learned
attacker is `policy:name=prbi-0`, or a file of yours; a class of yours is `module:Class`. The same command goes on where
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

from agents.arena import Bars, Conditions, make_attacker
from agents.arena.progress import duel
from cp_env import evaluation
from cp_env.evaluation.report.benchmark import GLOSSARY
from cp_env.evaluation.report.video import film
from cp_env.rendering.frame import Image3, write_gif


@dataclass(frozen=True)
class Args(Conditions):
    """Defenders × attacks × liars on test scenes."""

    defenders: tuple[str, ...] = ("none", "ego_only", "prbi", "prbi:threshold=calibrated", "oracle")
    attackers: tuple[str, ...] = ("none", "pgd")
    ks: tuple[int, ...] = (1, 2, 3, 4)  # liars among `vehicles`
    seeds: tuple[int, ...] = (0,)
    fusion: str = "mean"  # or max, sum, v2vnet, disconet
    budget: float = 0.3  # Δ
    workers: int = 1  # processes
    out: Path = Path("out/benchmark")
    gif: bool = True  # also film one episode of the first scene
    small: bool = False  # three scenes, 30 frames, k = 2

    def cut(self) -> Args:
        """Itself, or the small cut."""
        return replace(self, n_scenes=3, frames=30, ks=(2,), batch=3) if self.small else self


def main(args: Args) -> None:
    console = Console()
    torch.set_num_threads(args.threads)
    protocol = args.on_scenes(budget=args.budget, fusion=args.fusion)
    cells = evaluation.plan(
        protocol,
        defenders=args.defenders,
        attacks=args.attackers,
        ks=args.ks,
        seeds=args.seeds,
        batch=args.batch,
    )
    crew = evaluation.Crew(make_attacker=make_attacker, workers=args.workers, threads=args.threads)
    store = evaluation.Store(args.out, evaluation.open_bank(protocol).detector.digest)
    with Bars(console) as bars:
        bars.count("encoding", evaluation.prepare(cells, protocol, crew), len(protocol.names))
        bars.count("playing", evaluation.run(cells, protocol, store, crew), len(cells), duel)
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


def filmed(args: Args, protocol: evaluation.Protocol) -> list[Image3]:
    """One episode of PRBI (if it plays) against the last attack."""
    defender = next((name for name in args.defenders if name.startswith("prbi")), args.defenders[-1])
    k = min(max(args.ks), 2)
    cell = evaluation.Cell(defender, args.attackers[-1], k, args.seeds[0], protocol.names[:1])
    return film(cell, protocol, evaluation.open_bank(protocol), make_attacker)


if __name__ == "__main__":
    main(tyro.cli(Args).cut())
