"""Adaptive attacks, each defender's own among them: what they cost, and which vehicles are flagged.

    python examples/reproduce/adaptive_attacks.py --out out/adaptive        # six minutes of a core

The options were chosen on calibration scenes; the results are of test scenes. Run it again to go on where it stopped.
"""

from __future__ import annotations

from collections.abc import Sequence
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
from cp_env.metrics.shares import share_interval
from cp_env.scenes import open_source
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

THRESHOLD_AWARE = {
    "prbi": "in_loop:threshold=0.35,steps=6",
    "prbi:threshold=calibrated": "in_loop:threshold=0.48,steps=6",
    "robosac": "in_loop:reference=ego,threshold=0.3,steps=6",
    "pasac:score=similarity": "in_loop:reference=ego,groups=halves,threshold=0.37,steps=6",
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

    def row(self) -> str:
        """A row of the table."""
        episodes = share_interval([float(np.mean(r.damage)) for r in self.records])
        similarity = np.mean([np.mean(r.similarity[1:]) for r in self.records])
        verifications = np.mean([np.mean(r.verifications[r.grace_frames :]) for r in self.records])
        id_rates = np.mean([id_rate(r.suspects, r.attackers) for r in self.records])
        mc_rates = np.mean([mc_rate(r.suspects, r.attackers, r.n_maps) for r in self.records])
        figures = f"{similarity:.2f} | {verifications:.1f} | {id_rates:.2f} | {mc_rates:.2f}"
        return (
            f"| {self.defender} | {self.attack} | {_interval(episodes.mean, episodes.low, episodes.high)} | {figures} |"
        )


def main(args: Args) -> None:
    torch.set_num_threads(1)
    graced = Conditions(args.scenes, chosen(args), args.frames)
    workers = evaluation.Workers(make_attack=make_attack, processes=args.workers)
    store = evaluation.Store(args.out, evaluation.open_bank(graced).detector.digest)
    lines: list[Line] = []
    for defender in args.defenders:
        for conditions, attacks in (
            (graced, (*COMMON, *_threshold_aware(defender))),
            (replace(graced, grace_frames=0), (FIRST,)),
        ):
            runs = evaluation.plan_runs(
                conditions, defenders=[defender], attacks=attacks, ks=[args.k], seeds=[args.seed], batch=args.n_scenes
            )
            for run in evaluation.execute(runs, conditions, store, workers):
                print(f"played {run.defender} against {run.attack}", flush=True)
            lines += _lines(store.load(runs, conditions))
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
    head = [
        "| defender | attack | detection loss/frame | similarity | verifications/frame "
        "| ID rate (TPR) | MC rate (FPR) |",
        "|---|---|--:|--:|--:|--:|--:|",
    ]
    rows = [*head, *(line.row() for line in lines), ""]
    for defender in args.defenders:
        mine = [line for line in lines if line.defender == defender]
        worst = max(mine, key=lambda line: line.damage)
        pgd = next(line for line in mine if line.attack == COMMON[0])
        rows.append(f"* {defender}: {worst.attack}, {worst.damage:.2f} a frame; {pgd.attack} {pgd.damage:.2f}")
    return rows


def _threshold_aware(defender: str) -> tuple[str, ...]:
    return (THRESHOLD_AWARE[defender],) if defender in THRESHOLD_AWARE else ()


def _lines(results: dict[Run, tuple[Record, ...]]) -> list[Line]:
    graced = {0: " (no grace)", 1: ""}
    return [Line(c.defender, c.attack + graced[r[0].grace_frames], r) for c, r in results.items()]


def _interval(mean: float, low: float, high: float) -> str:
    return f"{mean:.2f} [{max(low, 0):.2f}, {high:.2f}]"


if __name__ == "__main__":
    main(tyro.cli(Args))
