"""The episode in which each defender loses most."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from cp_env.evaluation.analysis.worst_case import damage_a_frame
from cp_env.evaluation.plan.grid import Board, Played
from cp_env.evaluation.plan.runs import NOBODY, Cell


@dataclass(frozen=True)
class Worst:
    """The episode in which a defender's ego lost the most, and the film of it."""

    cell: Cell  # of one scene
    damage: float  # a frame
    gif: Path


def worst_episodes(board: Board, played: Played, folder: Path) -> dict[str, Worst]:
    """By defender, over all attacks, scenes and seeds; where its film is or will be, in `folder`."""
    worst: dict[str, Worst] = {}
    for cell, records in played.items():
        if cell.attack == NOBODY or not cell.k:
            continue
        for record in records:
            damage = damage_a_frame(record, board.protocol.frames)
            if cell.defender not in worst or damage > worst[cell.defender].damage:
                alone = replace(cell, names=(record.scene,))
                gif = folder / f"{alone.slug(board.protocol, board.store.detector)}.gif"
                worst[cell.defender] = Worst(alone, damage, gif)
    return worst
