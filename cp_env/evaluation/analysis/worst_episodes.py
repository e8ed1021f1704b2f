"""The episode in which each defender loses most."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from cp_env.evaluation.analysis.measures import damage_per_frame
from cp_env.evaluation.plan.grid import Grid, Results
from cp_env.evaluation.plan.runs import NO_ATTACK, Run


@dataclass(frozen=True)
class Worst:
    """The episode in which a defender lost the most, and its video."""

    run: Run  # of one scene
    damage: float  # per frame
    gif: Path


def worst_episodes(grid: Grid, results: Results, folder: Path) -> dict[str, Worst]:
    """The worst episode of each defender, over all attacks, scenes and seeds; its video belongs in `folder`."""
    worst: dict[str, Worst] = {}
    for run, records in results.items():
        if run.attack == NO_ATTACK or not run.k:
            continue
        for record in records:
            damage = damage_per_frame(record, grid.conditions.frames)
            if run.defender not in worst or damage > worst[run.defender].damage:
                episode = replace(run, names=(record.scene,))
                gif = folder / f"{episode.slug(grid.conditions, grid.store.detector)}.gif"
                worst[run.defender] = Worst(episode, damage, gif)
    return worst
