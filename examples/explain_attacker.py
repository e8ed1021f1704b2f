"""What a learned attack does and when: the numbers it plays, by the state of the defender at that moment.

    python examples/explain_attacker.py                                # the policies that ship with the package
    python examples/explain_attacker.py --policies runs/prbi-*/policy.safetensors

A frame belongs to one of three moments, by the outcome of the frame before it: `calm` (the view with everyone fused
resembled the last trusted view), `alarmed` (it did not, and the defender has not converged yet), `sure` (the defender
has converged).
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
import torch
import tyro
from rich.console import Console
from rich.table import Table

from agents.learning.policy import Policy, load_policy, policy_names
from agents.learning.rollout import open_bank
from cp_env.envs.actions import lane_aimed, similarity_bounded
from cp_env.envs.actions.guided import Guidance
from cp_env.evaluation import Conditions, Rollout, Run
from cp_env.progress import track
from cp_env.world.situation import Outcome

MOMENTS = ("calm", "alarmed", "sure")
MIDDLE = {"stealth": similarity_bounded.MIDDLE, "critical": lane_aimed.MIDDLE}
"""Actions with a floor, and what 0 means there; the aim of `critical` is ahead and to the left, not east and north."""

ALARM = 0.35
"""Similarity below which PRBI's paper calls a frame abnormal."""

UNITS = {
    "strength": "share of Δ",
    "spoof": "0 hides, 1 spoofs",
    "drift": "weight of moving boxes",
    "x": "aim, m",
    "y": "aim, m",
    "width": "of the aim, m",
    "persistence": "of the last perturbation",
    "fires": "share of frames",
    "floor": "similarity",
}


@dataclass
class Args:
    policies: list[str] = field(default_factory=lambda: [name for name in policy_names() if name.startswith("prbi-")])
    """names of shipped policies, or .safetensors files"""
    scenes: str = "town/calibration"
    n_scenes: int = 4
    """how many of them, one episode each"""
    seed: int = 0
    """of the attackers"""


def moments(outcome: Outcome | None, worlds: int) -> list[str]:
    """In which moment each world is."""
    if outcome is None:
        return ["calm"] * worlds
    alarmed = outcome.similarity < ALARM
    sure = [verdict.converged for verdict in outcome.verdicts]
    return ["sure" if s else "alarmed" if a else "calm" for s, a in zip(sure, alarmed, strict=True)]


@dataclass(frozen=True)
class Recorded:
    """A policy, with what it played last."""

    policy: Policy
    played: list[np.ndarray] = field(default_factory=lambda: [np.empty(0)])

    @property
    def options(self) -> dict[str, Any]:
        return self.policy.options

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        self.played[0] = self.policy(observations)
        return self.played[0]


def watch(policy: Policy, args: Args) -> dict[str, list[np.ndarray]]:
    """What every slot's numbers mean (8 or 9, in their units) in every frame, by moment; grace frames are left out."""
    bank, recorded = open_bank(args.scenes, args.n_scenes), Recorded(policy)
    names, frames = bank.source.names(), policy.options["max_frames"]
    conditions = Conditions(scenes=bank.source, names=names, frames=frames, n_vehicles=policy.options["n_vehicles"])
    rollout = Rollout(
        Run(policy.defender, "policy", policy.options["n_attackers"], args.seed, names), conditions, bank, recorded
    )
    played: dict[str, list[np.ndarray]] = defaultdict(list)
    outcome: Outcome | None = None
    for frame in range(frames):
        before, outcome = outcome, rollout.step()
        numbers = meaning(recorded.played[0], policy.options["action"], rollout.world.detector.extent)
        if frame >= conditions.grace_frames:
            for moment, slots in zip(moments(before, len(names)), numbers, strict=True):
                played[moment] += list(slots)
    return played


def meaning(actions: np.ndarray, action: str, extent: float) -> np.ndarray:
    """The numbers of guided, stealth or critical actions in the units of UNITS, in its order."""
    middle = MIDDLE.get(action)
    actions, *floor = (actions,) if middle is None else similarity_bounded.read(actions, middle)
    guidance = Guidance.read(torch.from_numpy(actions), extent)
    return np.stack([*(getattr(guidance, f.name).numpy() for f in fields(Guidance)), *floor], axis=-1)


def main(args: Args) -> None:
    torch.set_num_threads(1)
    console = Console()
    for name in track(args.policies, "playing", unit="policy"):
        played = watch(load_policy(name), args)
        total = sum(len(rows) for rows in played.values())
        table = Table("number", *MOMENTS, title=f"{name}: mean ± deviation over slots and frames")
        table.add_row("share of frames", *(f"{len(played[moment]) / total:.0%}" for moment in MOMENTS))
        width = next(len(rows[0]) for rows in played.values() if rows)
        for column, (number, unit) in enumerate(list(UNITS.items())[:width]):
            cells = [np.array(played[moment])[:, column] if played[moment] else None for moment in MOMENTS]
            shown = ["" if cell is None else f"{cell.mean():.2f} ± {cell.std():.2f}" for cell in cells]
            table.add_row(f"{number} ({unit})", *shown)
        console.print(table)


if __name__ == "__main__":
    main(tyro.cli(Args))
