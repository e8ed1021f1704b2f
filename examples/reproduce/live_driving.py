"""The closed loop: an ego that drives on its defended output in live traffic, which reacts to it.

    python examples/reproduce/live_driving.py
    python examples/reproduce/live_driving.py --scenes "sumo:urban?density=0.5" --n-scenes 3 --defenders prbi bayes

Needs the extra `sumo`. In every frame all connected vehicles scan the traffic of now, the attackers perturb their maps,
the ego fuses and defends, and the driver model brakes for what the output shows. SUMO moves everyone else, who see the
true ego (`cp_env.scenes.sumo.reactive`). The first two rows are bounds without a detector, the third drives on the
output without an attack. Drives of one scene begin alike, with the same attackers.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
import torch
import tyro
from rich.console import Console
from rich.table import Table

from agents.arena import make_attack
from cp_env.detector.registry import open_detector
from cp_env.evaluation import Conditions, Run
from cp_env.evaluation.execution.live_drive import LiveDrive, drive_live, drive_on, nothing, truth
from cp_env.metrics.intervals import rate_interval, t_interval
from cp_env.scenes import open_source
from cp_env.scenes.sumo.live import LiveSumo
from cp_env.scenes.sumo.reactive import open_stage

WIDTH = 230
"""Characters of a line, so that no cell is cut."""


@dataclass(frozen=True)
class Args:
    """What is driven."""

    scenes: tuple[str, ...] = ("sumo:urban", "sumo:suburban", "sumo:intersection")
    n_scenes: int = 2  # the first of each
    frames: int = 60
    defenders: tuple[str, ...] = ("none", "prbi")
    attack: str = "nearest_removal:steps=8"
    n_attackers: int = 2
    seed: int = 0


def open_live(spec: str) -> LiveSumo:
    """A source of live scenes. ValueError for one that is recorded."""
    source = open_source(spec)
    if not isinstance(source, LiveSumo):
        raise ValueError(f"only live traffic reacts: choose scenes such as sumo:urban, not {spec}")
    return source


def drives(args: Args) -> dict[str, list[LiveDrive]]:
    """The drives of every row of the table, scene by scene."""
    found: dict[str, list[LiveDrive]] = {}
    detector, attack = open_detector("cp_env", fusion="mean"), make_attack(args.attack)
    places = [(source, name) for source in map(open_live, args.scenes) for name in source.names()[: args.n_scenes]]
    runs = [("the unattacked output", "none", "none", 0)]
    runs += [(f"{args.attack}, {one}", one, args.attack, args.n_attackers) for one in args.defenders]
    for source, name in places:
        conditions = Conditions(source, (name,), args.frames)
        with open_stage(source, name) as stage:
            for what, perceive in (("every vehicle in range", truth), ("nothing", nothing)):
                found.setdefault(what, []).append(drive_on(stage, perceive, frames=args.frames))
            for what, defender, named, k in runs:
                run = Run(defender, named, k, args.seed, (name,))
                scripted = attack if k else make_attack("none")
                found.setdefault(what, []).append(drive_live(stage, run, conditions, detector, scripted))
    return found


def table(found: dict[str, list[LiveDrive]]) -> Table:
    """One row for each way to perceive."""
    n = len(next(iter(found.values())))
    made = Table(title=f"{n} drives each")
    for heading in (
        "perceived",
        "collisions",
        "with a hard braking",
        "hard brakings a drive",
        "least time to collision (s)",
        "mean speed (m/s)",
        "struck from behind",
        "touched by crossing vehicles",
        "detection loss/frame",
    ):
        made.add_column(heading)
    for what, of_scenes in found.items():
        ends = [one.drive for one in of_scenes]
        nearest = [end.min_time_to_collision for end in ends if np.isfinite(end.min_time_to_collision)]
        made.add_row(
            what,
            f"{rate_interval(sum(end.collided for end in ends), n):.2f}",
            f"{rate_interval(sum(end.hard_brakings > 0 for end in ends), n):.2f}",
            f"{t_interval([end.hard_brakings for end in ends], least=0.0):.2f}",
            f"{t_interval(nearest, least=0.0):.1f}" if nearest else "",
            f"{t_interval([end.mean_speed for end in ends], least=0.0):.2f}",
            str(sum(one.struck for one in of_scenes)),
            str(sum(one.crossed for one in of_scenes)),
            f"{np.mean([one.damage for one in of_scenes]):.3f}",
        )
    return made


def main(args: Args) -> None:
    torch.set_num_threads(1)
    began = time.perf_counter()
    found = drives(args)
    console = Console(width=WIDTH)
    console.print(table(found))
    console.print(f"{sum(map(len, found.values()))} drives in {time.perf_counter() - began:.0f} s")


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
