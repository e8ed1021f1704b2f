"""How much longer sealed runs take: the same runs, open and sealed by turns, in one process.

    OMP_NUM_THREADS=1 python benchmarks/sealed.py

Prints seconds of play and their ratio for each defender, and for all together. The start of the sealed process counts.
Frames are encoded before. PGD is computed once and kept, as in the arena, so what is timed is the world and the
defence: attacks that know the defence take longer, and their ratio is nearer to 1.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from statistics import median

import torch
import tyro

import defenders
from agents.arena import CommonOptions, make_attack
from cp_env import evaluation


@dataclass(frozen=True)
class Args(CommonOptions):
    """Open and sealed runs by turns."""

    n_scenes: int | None = 3
    frames: int = 20
    batch: int = 3
    attack: str = "pgd"
    defenders: tuple[str, ...] = defenders.names()
    repeats: int = 3
    seed: int = 0


def main(args: Args) -> None:
    torch.set_num_threads(args.threads)
    conditions = args.on_scenes()
    bank = evaluation.open_bank(conditions)

    def seconds(defender: str, sealed: bool) -> float:
        run = evaluation.Run(defender, args.attack, 2, args.seed, conditions.names)
        start = time.perf_counter()
        evaluation.play(run, replace(conditions, sealed=sealed), bank, make_attack(args.attack))
        return time.perf_counter() - start

    seconds("none", False)  # encodes
    total = {False: 0.0, True: 0.0}
    print(f"{args.attack}, {len(conditions.names)} scenes of {args.frames} frames, {args.repeats} turns")
    for defender in args.defenders:
        turns = [{sealed: seconds(defender, sealed) for sealed in (False, True)} for _ in range(args.repeats)]
        middle = {sealed: median(turn[sealed] for turn in turns) for sealed in (False, True)}
        for sealed, value in middle.items():
            total[sealed] += value
        print(line(defender, middle))
    print(line("all", total))


def line(what: str, seconds: Mapping[bool, float]) -> str:
    """Seconds of open and of sealed play."""
    open_, sealed = seconds[False], seconds[True]
    return f"{what:24} open {open_:6.2f} s   sealed {sealed:6.2f} s   × {sealed / open_:.2f}"


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
