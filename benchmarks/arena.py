"""Arena cells an hour on one and on two workers, by turns in one run, from the moment every worker has finished a cell.

    python benchmarks/arena.py

A cell is PRBI or no defence against PGD of 15 steps on whom the ego fused (so that it is computed anew in every cell),
two liars of five, two small scenes in lock-step, one torch thread a worker. What processes cost to start is left out,
as a run of hours does not feel it.
"""

from __future__ import annotations

import os
import statistics
import tempfile
import time
from dataclasses import dataclass

import tyro

from agents.arena import make_attacker
from cp_env.evaluation import Crew, Protocol, Store, plan, prepare, run
from tests.helpers.toy_scenes import ToySource

ATTACK = "pgd:audience=fused"


@dataclass(frozen=True)
class Args:
    """How long to measure."""

    workers: tuple[int, ...] = (1, 2)
    cells: int = 16  # a round
    frames: int = 6  # of a cell's two scenes
    rounds: int = 3


def cells_an_hour(args: Args, protocol: Protocol, workers: int) -> float:
    """One round, in an empty folder."""
    seeds = tuple(range(args.cells // 2))
    cells = plan(protocol, defenders=("none", "prbi"), attacks=(ATTACK,), ks=(2,), seeds=seeds)
    crew = Crew(make_attacker=make_attacker, workers=workers)
    with tempfile.TemporaryDirectory() as folder:
        ends = [time.perf_counter() for _ in run(cells, protocol, Store(folder), crew)]
    return 3600 * (len(ends) - workers) / (ends[-1] - ends[workers - 1])


def main(args: Args) -> None:
    source = ToySource(n_frames=args.frames)
    protocol = Protocol(source, source.names(), frames=args.frames)
    first = plan(protocol, defenders=("none",), attacks=(ATTACK,), ks=(2,), seeds=(0,))
    list(prepare(first, protocol, Crew(make_attacker=make_attacker)))
    rates: dict[int, list[float]] = {workers: [] for workers in args.workers}
    for number in range(args.rounds):
        for workers in args.workers:
            rates[workers].append(cells_an_hour(args, protocol, workers))
            load = os.getloadavg()[0]
            print(
                f"round {number}, {workers} workers: {rates[workers][-1]:.0f} cells an hour (load {load:.1f})",
                flush=True,
            )
    base = statistics.median(rates[args.workers[0]])
    for workers, of in rates.items():
        middle, spread = statistics.median(of), f"[{min(of):.0f}, {max(of):.0f}]"
        print(f"{workers} workers: median {middle:.0f} cells an hour {spread}, {middle / base:.2f} ×")


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
