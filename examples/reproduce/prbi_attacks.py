"""Attacks on the logic of the defence under a perfect verifier: PRBI in four versions, ROBOSAC, PASAC and `bayes`.

    python examples/reproduce/prbi_attacks.py                                    # PRBI in four versions, and the others
    python examples/reproduce/prbi_attacks.py --defenders prbi mine:BestPair     # any defenders

Situations, with n = 5 vehicles and k = 2 attackers unless stated otherwise:

* "all along": the paper's attack, in every frame but the first.
* "first frame": the attack begins in the first frame, which the paper trusts.
* "every 3", "every 5": all attackers are active in every third or fifth frame (Table 6).
* "turncoat": one of the attackers is benign until frame 20.
* "out of step": one attacker is active in all frames, the others in every third frame.
* "all but one", "nobody": k = 4; k = 0 for 1,000 frames.
* "framing": k = 1. The perturbation shows only in groups that contain vehicle 0, which is benign. Verdicts on groups
  cannot separate the two vehicles.
* "appears": one of the attackers is absent before frame 20.
* "drops out": a benign vehicle is absent in frames 2 to 21.
* "comes and goes": the attackers are present, and active, in every third frame only.

Convergence rate: share of the episodes that have converged in the last frame. Exact: share in which exactly the
attackers are flagged then. ID rate and MC rate: share of the attackers and of the benign vehicles that are flagged
then. Fooled: frames of 40 (1,000) in which the ego's output was contaminated. Verifications: per frame, and the most in
any frame.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from rich.console import Console
from rich.progress import track
from rich.table import Table

import defenders
from defenders import Defender
from defenders.simulation.statistics import EpisodeStats, members, play_many
from defenders.simulation.verifier import Group
from defenders.simulation.world import Scenario, Schedule, every, turning

FIVE = Scenario(n_vehicles=5, n_attackers=2, max_frames=40, until_converged=False)


def out_of_step(frame: int, attackers: Group) -> Group:
    """The first attacker is always active, the others in every third frame."""
    return attackers if frame % 3 == 0 else frozenset(sorted(attackers)[:1])


def framing(group: Group, active: Group, rng: np.random.Generator) -> float:
    """The perturbation shows in groups that contain vehicle 0, and in no others."""
    return float(not active or 0 not in group)


def late(frame: int, attackers: Group) -> Group:
    """The attacker of highest number is absent before frame 20."""
    return frozenset(sorted(attackers)[-1:]) if frame < 20 else frozenset()


def holiday(frame: int, attackers: Group) -> Group:
    """The benign vehicle of lowest number, but never the ego, is absent in the frames 2 to 21."""
    return frozenset({min({1, 2, 3, 4} - attackers)}) if 2 <= frame < 22 else frozenset()


def seldom_there(frame: int, attackers: Group) -> Group:
    """The attackers, but never the ego, are absent in two of three frames."""
    return attackers - {0} if (frame - 1) % 3 else frozenset()


def absent(schedule: Schedule, **options: Any) -> Scenario:
    return replace(FIVE, absent=schedule, **options)


SITUATIONS = {
    "all along": FIVE,
    "first frame": replace(FIVE, grace_frames=0),
    "every 3": replace(FIVE, schedule=every(3, start=1)),
    "every 5": replace(FIVE, schedule=every(5, start=1)),
    "turncoat": replace(FIVE, schedule=turning(20)),
    "out of step": replace(FIVE, schedule=out_of_step),
    "all but one": replace(FIVE, n_attackers=4),
    "nobody": replace(FIVE, n_attackers=0, max_frames=1000),
    "framing": replace(FIVE, n_attackers=1, benign={0}, similarity_model=framing),
    "appears": absent(late),
    "drops out": absent(holiday),
    "comes and goes": replace(FIVE, absent=seldom_there, schedule=every(3, start=1)),
}
PRBI = ("prbi", "prbi:rearm=True", "robust_prbi", "robust_prbi:rearm=True")
OTHERS = ("robosac", "pasac:score=similarity", "bayes:likelihood=perfect")


@dataclass
class Args:
    episodes: int = 100
    """of each situation; of those of 1,000 frames, one in 25"""
    seed: int = 0
    defenders: tuple[str, ...] = (*PRBI, *OTHERS)
    out: Path = Path("out/prbi/attacks.json")


@dataclass(frozen=True)
class Row:
    convergence_rate: float
    exact_identification: float
    id_rate: float | None
    mc_rate: float
    fooled: float  # frames an episode
    verifications: float  # a frame
    max_verifications: int


def measure(defender: Defender, scenario: Scenario, episodes: int, seed: int) -> Row:
    stats = play_many(defender, scenario, episodes=max(episodes * 40 // scenario.max_frames, 1), seed=seed)
    return Row(
        convergence_rate=float(stats.converged.mean()),
        exact_identification=float(stats.exact_identification.mean()),
        id_rate=float(stats.identified.mean()) if scenario.n_attackers else None,
        mc_rate=float(stats.false_accusation_rate.mean()),
        fooled=float(fooled(stats, scenario).sum(axis=1).mean()),
        verifications=float(stats.all_verifications.mean()),
        max_verifications=int(stats.all_verifications.max()),
    )


def fooled(stats: EpisodeStats, scenario: Scenario) -> np.ndarray:
    """Whether the output of a frame was contaminated [E, T]."""
    fused = stats.fused_attackers > 0
    return fused & members(stats.fused, stats.n_vehicles)[..., 0] if scenario.similarity_model is framing else fused


def main(args: Args) -> None:
    rows = {
        f"{situation} | {name}": measure(defenders.make(name), scenario, args.episodes, args.seed)
        for situation, scenario in track(SITUATIONS.items(), "playing", transient=True)
        for name in args.defenders
    }
    table = Table(
        "situation",
        "defender",
        "convergence rate",
        "exact",
        "ID rate (TPR)",
        "MC rate (FPR)",
        "fooled",
        "verifications/frame",
        "max. verifications",
    )
    for i, (key, row) in enumerate(rows.items(), 1):
        situation, name = key.split(" | ")
        shares = [
            f"{x:.2f}" if x is not None else "–"
            for x in (row.convergence_rate, row.exact_identification, row.id_rate, row.mc_rate)
        ]
        figures = [*shares, f"{row.fooled:.1f}", f"{row.verifications:.2f}", str(row.max_verifications)]
        table.add_row(situation, name, *figures, end_section=i % len(args.defenders) == 0)
    Console(width=120).print(table)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    args.out.write_text(json.dumps({key: vars(row) for key, row in rows.items()}, indent=1) + "\n")
    print("written:", args.out)


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
