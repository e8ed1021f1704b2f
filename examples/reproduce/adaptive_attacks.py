"""Attackers that know the defence, each defender's own among them: what they cost, and who is blamed for it.

    python examples/reproduce/adaptive_attacks.py --out out/adaptive        # six minutes of a core

The knobs were chosen on the calibration scenes; the figures are of test scenes. Run it again to go on where it stopped.
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
from agents.attacks.cached import Remembered
from agents.protocol import Attacker
from cp_env import evaluation
from cp_env.evaluation import Cell, Protocol, Record
from cp_env.metrics.identification import id_rate, mc_rate
from cp_env.metrics.intervals import t_interval
from cp_env.scenes import open_source

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

TOLD = {
    "prbi": "in_loop:threshold=0.35,steps=6",
    "prbi:threshold=calibrated": "in_loop:threshold=0.48,steps=6",
    "robosac": "in_loop:reference=ego,threshold=0.3,steps=6",
    "pasac:score=similarity": "in_loop:reference=ego,groups=halves,threshold=0.37,steps=6",
    "bayes": "in_loop:threshold=0.6,steps=6",
}
"""The attacker in the loop is told what each defender compares with what: its thresholds; for bayes, which has none,
the similarity that did most damage on the calibration scenes."""

FIRST = "poison:steps=6"
"""Plays without a frame of grace."""


@dataclass(frozen=True)
class Args:
    """Attackers that know the defence."""

    scenes: str = "town/test"
    n_scenes: int = 3  # spread evenly over the list
    frames: int = 15  # of an episode, five a second
    k: int = 2  # liars among five, drawn by the seed
    seed: int = 0
    defenders: tuple[str, ...] = tuple(TOLD)
    workers: int = 1
    out: Path = Path("out/adaptive")


@dataclass(frozen=True)
class Line:
    """One attacker against one defender."""

    defender: str
    attack: str
    records: tuple[Record, ...]

    @property
    def damage(self) -> float:
        """In a frame that could be attacked."""
        return float(np.mean([np.mean(r.damage[r.grace_frames :]) for r in self.records]))

    def told(self) -> str:
        """A row of the table."""
        episodes = t_interval([sum(r.damage) for r in self.records])
        similarity = np.mean([np.mean(r.similarity[1:]) for r in self.records])
        looks = np.mean([np.mean(r.verifications[r.grace_frames :]) for r in self.records])
        excluded = np.mean([id_rate(r.suspects, r.liars) for r in self.records])
        innocent = np.mean([mc_rate(r.suspects, r.liars, r.n_maps) for r in self.records])
        figures = f"{similarity:.2f} | {looks:.1f} | {excluded:.2f} | {innocent:.2f}"
        return (
            f"| {self.defender} | {self.attack} | {_interval(episodes.mean, episodes.low, episodes.high)} | {figures} |"
        )


def main(args: Args) -> None:
    torch.set_num_threads(1)
    graced = Protocol(args.scenes, chosen(args), args.frames)
    crew = evaluation.Crew(make_attacker=attacker, workers=args.workers)
    store = evaluation.Store(args.out, evaluation.open_bank(graced).detector.digest)
    lines: list[Line] = []
    for defender in args.defenders:
        for protocol, attacks in (
            (graced, (*COMMON, *_told(defender))),
            (replace(graced, grace_frames=0), (FIRST,)),
        ):
            cells = evaluation.plan(
                protocol, defenders=[defender], attacks=attacks, ks=[args.k], seeds=[args.seed], batch=args.n_scenes
            )
            for cell in evaluation.run(cells, protocol, store, crew):
                print(f"played {cell.defender} against {cell.attack}", flush=True)
            lines += _lines(store.load(cells, protocol))
    print("\n".join(table(lines, args)))


def chosen(args: Args) -> tuple[str, ...]:
    """The scenes that are played."""
    names = open_source(args.scenes).names()
    return tuple(names[i * len(names) // args.n_scenes] for i in range(args.n_scenes))


@lru_cache
def attacker(name: str, **knobs: Any) -> Attacker:
    """PGD knows of no defence: what it did is remembered from one defender to the next."""
    made = agents.make(name, **knobs)
    return Remembered(made) if name == "pgd" else made


def table(lines: Sequence[Line], args: Args) -> list[str]:
    """The table, and who is the worst for each defender."""
    head = ["| defender | attack | damage | similarity | looks | liars | innocents |", "|---|---|--:|--:|--:|--:|--:|"]
    rows = [*head, *(line.told() for line in lines), ""]
    for defender in args.defenders:
        mine = [line for line in lines if line.defender == defender]
        worst = max(mine, key=lambda line: line.damage)
        pgd = next(line for line in mine if line.attack == COMMON[0])
        rows.append(f"* {defender}: {worst.attack}, {worst.damage:.2f} a frame; {pgd.attack} {pgd.damage:.2f}")
    return rows


def _told(defender: str) -> tuple[str, ...]:
    return (TOLD[defender],) if defender in TOLD else ()


def _lines(played: dict[Cell, tuple[Record, ...]]) -> list[Line]:
    graced = {0: " (no grace)", 1: ""}
    return [Line(c.defender, c.attack + graced[r[0].grace_frames], r) for c, r in played.items()]


def _interval(mean: float, low: float, high: float) -> str:
    return f"{mean:.1f} [{max(low, 0):.1f}, {high:.1f}]"


if __name__ == "__main__":
    main(tyro.cli(Args))
