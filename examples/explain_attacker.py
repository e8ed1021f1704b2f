"""What a learned attacker does and when: the numbers it plays, by what the defender thinks at that moment.

    python examples/explain_attacker.py                                # the policies that ship with the package
    python examples/explain_attacker.py --policies runs/prbi-*/policy.safetensors

A frame belongs to one of three moments, by the outcome of the frame before it: `calm` (everyone fused looked like the
last trusted view), `alarmed` (it did not, and the defender is not sure yet), `sure` (the defender has converged).
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field, fields

import numpy as np
import torch
import tyro
from rich.console import Console
from rich.progress import track
from rich.table import Table

from agents.episodes import begin
from agents.policy import Policy, load_policy, policy_names
from agents.scenes import Some
from cp_env.action import Guidance
from cp_env.game import Game
from cp_env.world import Outcome

MOMENTS = ("calm", "alarmed", "sure")
ALARM = 0.35
"""Similarity below which PRBI's paper calls a frame abnormal."""

UNITS = {
    "strength": "share of Δ",
    "spoof": "0 hides, 1 spoofs",
    "drift": "weight of moving boxes",
    "x": "aim, m",
    "y": "aim, m",
    "width": "of the aim, m",
    "persistence": "of the last lie",
    "fires": "share of frames",
}


@dataclass
class Args:
    policies: list[str] = field(default_factory=lambda: [name for name in policy_names() if name.startswith("prbi-")])
    """names of shipped policies, or .safetensors files"""
    scenes: str = "town/calibration"
    n_scenes: int = 4
    """how many of them, one episode each"""
    seed: int = 0
    """of the liars"""


def moments(outcome: Outcome | None, worlds: int) -> list[str]:
    """In which moment each world is."""
    if outcome is None:
        return ["calm"] * worlds
    alarmed = outcome.similarity < ALARM
    sure = [verdict.converged for verdict in outcome.verdicts]
    return ["sure" if s else "alarmed" if a else "calm" for s, a in zip(sure, alarmed, strict=True)]


def watch(policy: Policy, game: Game, args: Args) -> dict[str, list[np.ndarray]]:
    """Every slot's guidance (8 numbers, in their units) in every frame, by moment; grace frames are left out."""
    extent = game.world.detector.extent
    observations = begin(game, game.world.bank.source.names(), args.seed)
    played: dict[str, list[np.ndarray]] = defaultdict(list)
    outcome: Outcome | None = None
    for frame in range(game.settings.max_frames):
        actions = policy(observations)
        guidance = Guidance.read(torch.from_numpy(actions), extent)
        numbers = np.stack([getattr(guidance, f.name).numpy() for f in fields(Guidance)], axis=-1)
        if frame >= game.settings.grace_frames:
            for moment, slots in zip(moments(outcome, game.num_envs), numbers, strict=True):
                played[moment] += list(slots)
        observations, *_ = game.step(actions)
        outcome = game.outcome
    return played


def main(args: Args) -> None:
    torch.set_num_threads(1)
    policies = [load_policy(name) for name in args.policies]
    source = Some(args.scenes, args.n_scenes)
    bank = None
    console = Console()
    for name, policy in track(list(zip(args.policies, policies, strict=True)), "playing"):
        game = Game(args.n_scenes, policy.defender, scenes=source, bank=bank, **policy.knobs)
        bank = game.world.bank
        played = watch(policy, game, args)
        total = sum(len(rows) for rows in played.values())
        table = Table("number", *MOMENTS, title=f"{name}: mean ± deviation over slots and frames")
        table.add_row("share of frames", *(f"{len(played[moment]) / total:.0%}" for moment in MOMENTS))
        for column, part in enumerate(fields(Guidance)):
            cells = [np.array(played[moment])[:, column] if played[moment] else None for moment in MOMENTS]
            shown = ["" if cell is None else f"{cell.mean():.2f} ± {cell.std():.2f}" for cell in cells]
            table.add_row(f"{part.name} ({UNITS[part.name]})", *shown)
        console.print(table)


if __name__ == "__main__":
    main(tyro.cli(Args))
