"""Adaptive attacks, each defender's own among them: what they cost, and which vehicles are flagged.

    python examples/reproduce/adaptive_attacks.py --out out/adaptive        # six minutes of a core

The options were chosen on calibration scenes; the results are of test scenes. Run it again to go on where it stopped.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro

import agents
from agents.attacks.cached import CachedAttack
from agents.protocol import Attack
from cp_env import evaluation
from cp_env.evaluation import Conditions, Record, Run
from cp_env.metrics.identification import id_rate, mc_rate
from cp_env.metrics.intervals import t_interval
from cp_env.metrics.shares import share_interval
from cp_env.scenes import open_source
from cp_env.settings import Precision
from defenders.registry import Spec

COMMON = (
    "pgd",
    "pgd:every=3",
    "eot:steps=6",
    "ramp:rate=0.3,first=0.2,steps=6",
    "blind:steps=6",
    "framing:steps=6,draws=1",
    "sacrifice:steps=6",
)
"""Against every defender; the first is what the others are measured by."""

ON_VERDICTS = ("framing", "sacrifice")
"""Attacks on a verdict that lasts: they have nothing to work on where each frame is judged anew."""

WITHOUT_MEMORY = ("robosac", "pasac")

THRESHOLD_AWARE = {
    "prbi": "in_loop:threshold=0.35,steps=6",
    "prbi:threshold=calibrated": "in_loop:threshold=0.49,steps=6",
    "robosac": "in_loop:reference=ego,threshold=0.3,steps=6",
    "pasac:score=similarity": "in_loop:reference=ego,groups=halves,threshold=0.52,steps=6",
    "bayes": "in_loop:threshold=0.6,steps=6",
}
"""The threshold-aware attack knows what each defender compares, and its thresholds; for bayes, which has none, the
similarity that did most damage on the calibration scenes."""

FIRST = "poison:steps=6"
"""Plays without a frame of grace."""


@dataclass(frozen=True)
class Args:
    """Adaptive attacks."""

    scenes: str = "town/test"
    n_scenes: int = 3  # spread evenly over the list
    frames: int = 15  # of an episode, five a second
    k: int = 2  # attackers among five, drawn by the seed
    seed: int = 0
    defenders: tuple[str, ...] = tuple(THRESHOLD_AWARE)
    attacks: tuple[str, ...] = COMMON  # beside the threshold-aware one and the one without grace
    precision: Precision = "float32"  # of the detector's maps, fusion and decoder
    batch: int = 7  # scenes in lock-step
    workers: int = 1
    out: Path = Path("out/adaptive")


@dataclass(frozen=True)
class Line:
    """One attack against one defender."""

    defender: str
    attack: str
    records: tuple[Record, ...]

    @property
    def damage(self) -> float:
        """In a frame that could be attacked."""
        return float(np.mean([np.mean(r.damage[r.grace_frames :]) for r in self.records]))

    def row(self, first: Line) -> str:
        """A row of the table; `first` is the line that its damage is compared with, by scene."""
        damages = [np.array([np.mean(r.damage) for r in line.records]) for line in (self, first)]
        cells = [
            f"{share_interval(damages[0]):.2f}",
            "" if self is first else f"{t_interval(damages[0] - damages[1]):+.2f}",
            f"{np.mean([np.mean(r.similarity[1:]) for r in self.records]):.2f}",
            f"{np.mean([np.mean(r.verifications[r.grace_frames :]) for r in self.records]):.1f}",
            f"{share_interval([id_rate(r.suspects, r.attackers) for r in self.records]):.2f}",
            f"{share_interval([mc_rate(r.suspects, r.attackers, r.n_maps) for r in self.records]):.2f}",
        ]
        return f"| {self.defender} | {self.attack} | {' | '.join(cells)} |"


def main(args: Args) -> None:
    torch.set_num_threads(1)
    graced = Conditions(args.scenes, chosen(args), args.frames, precision=args.precision)
    workers = evaluation.Workers(make_attack=make_attack, processes=args.workers)
    store = evaluation.Store(args.out, evaluation.open_bank(graced).detector.digest)
    lines: list[Line] = []
    for defender in args.defenders:
        for conditions, attacks in (
            (graced, against(defender, args.attacks)),
            (replace(graced, grace_frames=0), (FIRST,)),
        ):
            runs = evaluation.plan_runs(
                conditions, defenders=[defender], attacks=attacks, ks=[args.k], seeds=[args.seed], batch=args.batch
            )
            for run in evaluation.execute(runs, conditions, store, workers):
                print(f"played {run.defender} against {run.attack}", flush=True)
            lines += pooled(store.load(runs, conditions))
    print("\n".join(table(lines, args)))


def chosen(args: Args) -> tuple[str, ...]:
    """The scenes that are played."""
    names = open_source(args.scenes).names()
    return tuple(names[i * len(names) // args.n_scenes] for i in range(args.n_scenes))


@lru_cache
def make_attack(name: str, **options: Any) -> Attack:
    """PGD knows of no defence: its answers are cached from one defender to the next."""
    made = agents.make(name, **options)
    return CachedAttack(made) if Spec.parse(name).name == "pgd" else made


def table(lines: Sequence[Line], args: Args) -> list[str]:
    """The table, and the worst attack for each defender."""
    rows = [
        "| defender | attack | detection loss/frame | more than the first, paired | similarity | verifications/frame "
        "| ID rate (TPR) | MC rate (FPR) |",
        "|---|---|--:|--:|--:|--:|--:|--:|",
    ]
    by_defender = {name: [line for line in lines if line.defender == name] for name in args.defenders}
    firsts = {name: next(line for line in mine if line.attack == args.attacks[0]) for name, mine in by_defender.items()}
    rows += [line.row(firsts[line.defender]) for line in lines]
    rows.append("")
    for name, mine in by_defender.items():
        worst, first = max(mine, key=lambda line: line.damage), firsts[name]
        rows.append(f"* {name}: {worst.attack}, {worst.damage:.2f} a frame; {first.attack} {first.damage:.2f}")
    return rows


def against(defender: str, attacks: Sequence[str]) -> tuple[str, ...]:
    """The attacks that apply to a defender, and the one that knows its threshold."""
    forgets = Spec.parse(defender).name in WITHOUT_MEMORY
    applying = [attack for attack in attacks if not (forgets and Spec.parse(attack).name in ON_VERDICTS)]
    return (*applying, *(THRESHOLD_AWARE[name] for name in THRESHOLD_AWARE if name == defender))


def pooled(results: Mapping[Run, Sequence[Record]]) -> list[Line]:
    """A line for each defender and attack, over the scenes of all its runs."""
    graced = {0: " (no grace)", 1: ""}
    found: dict[tuple[str, str], list[Record]] = {}
    for run, records in results.items():
        found.setdefault((run.defender, run.attack + graced[records[0].grace_frames]), []).extend(records)
    return [Line(defender, attack, tuple(records)) for (defender, attack), records in found.items()]


if __name__ == "__main__":
    main(tyro.cli(Args))
