"""Constants of `bayes` that were chosen by hand, each beside other values of it, on calibration scenes.

    python examples/reproduce/bayes_choices.py --precision bfloat16
    python examples/reproduce/bayes_choices.py --scenes junction/calibration --n-scenes 10

One constant is changed at a time: g₂, the weight of a stealthy outlier; the probability of an attack below which
nothing is verified; and the share of an outlier's density that is the mean of all (`OUTLIER_MIX`). Every value meets
the same episodes. The difference to the shipped value is paired by scene, in detection loss per frame, its mean over
the attacks. A value is better if it does less damage, p < 0.05 after Holm's correction over all values, and flags no
more benign vehicles. No test scene is played. What is played is kept in `out`: the same command goes on where a killed
run stopped.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
import torch
import tyro
from rich.console import Console
from rich.progress import track
from rich.table import Table

import agents
from cp_env.evaluation import Conditions, Record, Run, Store, Workers, execute, open_bank, plan_runs
from cp_env.evaluation.analysis.comparisons import LEVEL, holm, paired_difference
from cp_env.evaluation.plan.runs import file_words
from cp_env.metrics.shares import share_interval
from cp_env.scenes import open_source
from cp_env.settings import Precision
from defenders.bayes import defender, likelihood, posterior

Played = dict[str, list[Record]]  # the episodes of one value, by attack

SHIPPED = "as shipped"
CONSTANTS: dict[str, tuple[ModuleType, str, tuple[float, ...]]] = {
    "g₂": (posterior, "OUTLIER_PRIOR", (1.0, 2.0, 8.0)),
    "alarm": (defender, "ALARM_PROB", (0.02, 0.1)),
    "OUTLIER_MIX": (likelihood, "OUTLIER_MIX", (0.1, 0.5)),
}
"""Where each constant stands, and the other values that it is given."""


@dataclass(frozen=True)
class Args:
    """What is played."""

    scenes: str = "town/calibration"
    n_scenes: int = 12  # the first of the source's list
    frames: int = 30
    attacks: tuple[str, ...] = (
        "pgd",
        "in_loop:threshold=0.35,steps=8",
        "in_loop:threshold=0.6,steps=8",
        "ramp:rate=0.3,first=0.2,steps=8",
    )
    k: int = 2
    defender: str = "bayes"
    precision: Precision = "float32"  # of the detector's maps, fusion and decoder
    seed: int = 0
    threads: int = 1
    out: Path = Path("out/bayes_choices")


def values() -> list[tuple[str, float | None]]:
    """The shipped values first, then each constant with each of its others."""
    return [(SHIPPED, None), *((name, value) for name, (_, _, others) in CONSTANTS.items() for value in others)]


def give(name: str, value: float) -> None:
    """Put a value in a constant's place, for the rest of the process."""
    module, attribute, _ = CONSTANTS[name]
    old = getattr(module, attribute)
    setattr(module, attribute, np.array([old[0], value]) if isinstance(old, np.ndarray) else value)


def plan(args: Args) -> tuple[list[Run], Conditions]:
    """The episodes that every value meets: without an attack, and under each."""
    names = tuple(open_source(args.scenes).names()[: args.n_scenes])
    conditions = Conditions(args.scenes, names, args.frames, precision=args.precision)
    attacks = ("none", *args.attacks)
    runs = plan_runs(conditions, defenders=(args.defender,), attacks=attacks, ks=(args.k,), seeds=(args.seed,), batch=6)
    return runs, conditions


def store_of(args: Args, label: str, conditions: Conditions) -> Store:
    """Where the episodes of one value are kept."""
    return Store(args.out / file_words(label), open_bank(conditions).detector.digest)


def play(args: Args, name: str, value: float | None, label: str) -> None:
    """Play what is missing of one value; in a process of its own, since tables rest on the constants."""
    torch.set_num_threads(args.threads)
    if value is not None:
        give(name, value)
    runs, conditions = plan(args)
    for _ in execute(runs, conditions, store_of(args, label, conditions), Workers(make_attack=agents.make)):
        pass


def survey(args: Args) -> dict[str, Played]:
    """Every value against every attack and against none; what is on disk already is read."""
    runs, conditions = plan(args)
    found: dict[str, Played] = {}
    for name, value in track(values(), "playing", console=Console(stderr=True)):
        label = name if value is None else f"{name} = {value:g}"
        store = store_of(args, label, conditions)
        if len(store.load(runs, conditions)) < len(runs):
            with multiprocessing.get_context("spawn").Pool(1) as pool:
                pool.apply(play, (args, name, value, label))
        found[label] = {}
        for run, records in store.load(runs, conditions).items():
            found[label].setdefault(run.attack, []).extend(records)
    return found


def flagged(records: Sequence[Record]) -> int:
    """Benign vehicles that are flagged in the end, over all episodes."""
    return sum(len(set(one.suspects) - set(one.attackers)) for one in records)


def table(found: Mapping[str, Played], args: Args) -> Table:
    """A row a value, beside the shipped one."""

    def damages(label: str, attack: str) -> list[float]:
        return [float(np.mean(one.damage)) for one in found[label][attack]]

    def over_attacks(label: str) -> np.ndarray:
        return np.mean([damages(label, attack) for attack in args.attacks], axis=0)

    made = Table(title=f"{args.defender}, {args.scenes}, {args.n_scenes} scenes of {args.frames} frames, k = {args.k}")
    played = (f"damage, {attack}" for attack in args.attacks)
    for heading in ("value", *played, "mean of these", "more than shipped, paired", "p (Holm)"):
        made.add_column(heading, overflow="fold")
    for heading in ("benign flagged, no attack", "under attack", "verifications, no attack"):
        made.add_column(heading, overflow="fold")
    others = [label for label in found if label != SHIPPED]
    compared = {label: paired_difference(over_attacks(label), over_attacks(SHIPPED)) for label in others}
    adjusted = dict(zip(others, holm([compared[label][1] for label in others]), strict=True))
    for label, of in found.items():
        made.add_row(
            label,
            *(f"{np.mean(damages(label, attack)):.3f}" for attack in args.attacks),
            f"{share_interval(over_attacks(label)):.3f}",
            f"{compared[label][0]:+.3f}" if label in compared else "",
            f"{adjusted[label]:.3f}{' *' if adjusted[label] < LEVEL else ''}" if label in compared else "",
            str(flagged(of["none"])),
            str(sum(flagged(of[attack]) for attack in args.attacks)),
            f"{np.mean([np.mean(one.verifications) for one in of['none']]):.2f}",
        )
    return made


def main(args: Args) -> None:
    Console(width=230).print(table(survey(args), args))


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
