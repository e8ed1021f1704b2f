"""Certified recall: the share of true vehicles that no k attackers can hide from an ego that lets single views vote.

    python examples/reproduce/certified_recall.py
    python examples/reproduce/certified_recall.py --vehicles 8

A property of scenes, detector and fleet: no attack, budget or seed enters (see `cp_env.metrics.certified`). Printed are
the shares of the vehicles that at least r of the n single views find, over frames spread over each scene.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
import tyro
from rich.console import Console
from rich.table import Table

from agents.arena.conditions import spread
from cp_env.metrics.certified import certified_recall
from cp_env.metrics.shares import share_interval
from cp_env.settings import WORLD_DEFAULTS
from cp_env.world.world import open_bank


@dataclass(frozen=True)
class Args:
    """What is looked at."""

    scenes: str = "town/test"
    n_scenes: int | None = None  # spread over the source; all by default
    frames: int = 10  # of each scene, spread over it
    vehicles: int = 5


def counts_of(args: Args) -> dict[str, list[int]]:
    """By scene: how many single views find each true vehicle of its frames."""
    bank = open_bank("mean", **WORLD_DEFAULTS | {"scenes": args.scenes})
    names = bank.source.names()
    found: dict[str, list[int]] = {}
    for name in names if args.n_scenes is None else spread(names, args.n_scenes):
        episode = bank.episode(name, args.vehicles, rsu=False)
        assert episode.witnesses is not None
        for frame in np.linspace(0, episode.scene.n_frames - 1, args.frames).astype(int).tolist():
            found.setdefault(name, []).extend(episode.witnesses[frame].tolist())
    return found


def main(args: Args) -> None:
    torch.set_num_threads(1)
    by_scene = counts_of(args)
    everyone = np.concatenate([np.array(counts) for counts in by_scene.values()])
    table = Table(
        title=f"{len(everyone)} vehicles in {args.frames} frames of {len(by_scene)} scenes, n = {args.vehicles}"
    )
    for heading in ("found by at least r single views", "share", "certified against k attackers", "mean over scenes"):
        table.add_column(heading, justify="right")
    for r in range(1, args.vehicles + 1):
        k, rest = divmod(r - 1, 2)
        over = share_interval([certified_recall(counts, k) for counts in by_scene.values()])
        table.add_row(str(r), f"{(everyone >= r).mean():.3f}", "" if rest else str(k), "" if rest else f"{over:.3f}")
    Console().print(table)


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
