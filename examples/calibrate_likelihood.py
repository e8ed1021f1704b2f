"""What similarities say of a group, for `bayes`: the means by size and attackers, and how well the densities fit.

    python examples/calibrate_likelihood.py              # measure and print
    python examples/calibrate_likelihood.py --cross      # also the log-likelihood of scenes left out, by kind

On the calibration scenes the views of all groups of five vehicles are compared, Eq. (5), with the views of all groups
in the frame before, and with the full view of the same frame: without an attack, under a loud one and under stealthy
ones. `cp-calibrate` measures the same and writes the densities where `bayes` finds them; how they are smoothed is in
`agents.calibration.densities`. A run that was killed goes on where it stopped.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
import tyro
from rich.console import Console
from rich.table import Table

from agents.arena.conditions import spread
from agents.calibration.comparisons import Episodes, Measurement, survey
from agents.calibration.densities import Smoothing, Values, by_kind, left_out
from agents.commands.common import Victim
from cp_env.progress import track
from cp_env.scenes import open_source
from cp_env.world.scene_cache import SceneBank


@dataclass(frozen=True)
class Args(Victim):
    scenes: str = "town/calibration+junction/calibration"
    n_scenes: int | None = None  # so many of them, spread evenly (all by default)
    episodes: Episodes = field(default_factory=Episodes)
    smoothing: Smoothing = field(default_factory=Smoothing)
    threads: int = 1
    out: Path = Path("out/likelihood")  # measurements, kept for the next run
    cross: bool = False  # also print the log-likelihood of scenes left out, by kind


def measured(args: Args) -> list[Measurement]:
    """Every scene under every attack."""
    bank = SceneBank(open_source(args.scenes), args.open_detector())
    return list(survey(bank, spread(bank.source.names(), args.n_scenes), args.episodes, args.out, track))


def report(values: Values, args: Args) -> Table:
    n = args.episodes.n_vehicles
    table = Table(
        "group size",
        "no attack",
        *(f"{k} {mode}" for mode in ("loud", "stealthy")[: args.episodes.n_modes] for k in range(1, n)),
        *(f"age {a}" for a in range(2, args.episodes.ages + 1)),
        title="mean similarity (spread) to a benign view of a frame before; without an attack, to the full view",
    )
    for size in range(1, n + 1):
        uncontaminated = [[("uncontaminated", age, size, n, size)] for age in range(1, args.episodes.ages + 1)]
        contaminated = [
            [("one_contaminated", m, size, d, other) for other in range(1, n + 1)]
            for m in range(1, args.episodes.n_modes + 1)
            for d in range(1, n)
        ]
        cells = [
            [x for kind in kinds for x in values.get(kind, [])]
            for kinds in [uncontaminated[0], *contaminated, *uncontaminated[1:]]
        ]
        found = [np.concatenate(cell) if cell else None for cell in cells]
        table.add_row(str(size), *("–" if x is None else f"{x.mean():.2f} ({x.std():.2f})" for x in found))
    return table


def main(args: Args) -> None:
    torch.set_num_threads(args.threads)
    measurements = measured(args)
    console = Console(width=160)
    console.print(report(by_kind(measurements, args.episodes), args))
    if args.cross:
        found = left_out(measurements, args.episodes, args.smoothing)
        console.print({what: round(score, 3) for what, score in found.items()})


if __name__ == "__main__":
    main(tyro.cli(Args))
