"""Arena runs an hour on one and on two workers, by turns in one process, from the end of every worker's first run on.

    python benchmarks/arena.py

A run is PRBI or no defence against PGD of 15 steps on the vehicles that the ego fused (so that it is computed anew in
every run), two attackers of five, two small scenes in lock-step, one torch thread a worker. The start of the processes
is left out, as it is nothing in a run of hours.
"""

from __future__ import annotations

import os
import statistics
import tempfile
import time
from dataclasses import dataclass

import tyro

from agents.arena import make_attack
from cp_env.evaluation import Conditions, Store, Workers, execute, plan_runs, prepare
from tests.helpers.toy_scenes import ToySource

ATTACK = "pgd:target_groups=fused"


@dataclass(frozen=True)
class Args:
    """How long to measure."""

    workers: tuple[int, ...] = (1, 2)
    runs: int = 16  # a round
    frames: int = 6  # of a run's two scenes
    rounds: int = 3


def runs_an_hour(args: Args, conditions: Conditions, workers: int) -> float:
    """One round, in an empty folder."""
    seeds = tuple(range(args.runs // 2))
    runs = plan_runs(conditions, defenders=("none", "prbi"), attacks=(ATTACK,), ks=(2,), seeds=seeds)
    pool = Workers(make_attack=make_attack, processes=workers)
    with tempfile.TemporaryDirectory() as folder:
        ends = [time.perf_counter() for _ in execute(runs, conditions, Store(folder), pool)]
    return 3600 * (len(ends) - workers) / (ends[-1] - ends[workers - 1])


def main(args: Args) -> None:
    source = ToySource(n_frames=args.frames)
    conditions = Conditions(source, source.names(), frames=args.frames)
    first = plan_runs(conditions, defenders=("none",), attacks=(ATTACK,), ks=(2,), seeds=(0,))
    list(prepare(first, conditions, Workers(make_attack=make_attack)))
    rates: dict[int, list[float]] = {workers: [] for workers in args.workers}
    for number in range(args.rounds):
        for workers in args.workers:
            rates[workers].append(runs_an_hour(args, conditions, workers))
            load = os.getloadavg()[0]
            print(
                f"round {number}, {workers} workers: {rates[workers][-1]:.0f} runs an hour (load {load:.1f})",
                flush=True,
            )
    base = statistics.median(rates[args.workers[0]])
    for workers, of in rates.items():
        middle, spread = statistics.median(of), f"[{min(of):.0f}, {max(of):.0f}]"
        print(f"{workers} workers: median {middle:.0f} runs an hour {spread}, {middle / base:.2f} ×")


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
