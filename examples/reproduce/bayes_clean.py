"""False alarms of `bayes` without an attack: the verdicts of thousands of frames on the detector.

    python examples/reproduce/bayes_clean.py
    python examples/reproduce/bayes_clean.py --scenes town/train --every 3

Every scene is one episode from its first frame on. A flagged vehicle is a suspect of the verdict. Left out/frame: the
mean number of vehicles that are not fused in a frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
import tyro
from rich.console import Console
from rich.progress import track
from rich.table import Table

from cp_env.detector import load_detector
from cp_env.scenes import open_source
from cp_env.settings import Fusion
from cp_env.world.scene_cache import SceneBank
from cp_env.world.world import World


@dataclass
class Args:
    scenes: str = "town/test"
    every: int = 1  # 3: play every third scene
    frames: int = 100  # of each, at most
    n_vehicles: int = 5
    defender: str = "bayes"
    fusion: Fusion = "mean"
    seed: int = 0
    threads: int = 1


@dataclass(frozen=True)
class Episode:
    scene: str
    frames: int
    flagged: int
    left_out: int
    verifications: int


def play(args: Args, bank: SceneBank, scene: str) -> Episode:
    world = World(1, defender=args.defender, bank=bank, n_vehicles=args.n_vehicles, n_attackers=0, fusion=args.fusion)
    world.reset([np.random.SeedSequence(args.seed)], options={"scene": scene, "start": 0})
    frames = min(args.frames, bank.source.load(scene).n_frames)
    nothing = torch.zeros_like(world.situation().received[:, :0])
    outcomes = [world.step(nothing) for _ in range(frames)]
    verdicts = [outcome.verdicts[0] for outcome in outcomes]
    return Episode(
        scene,
        frames,
        sum(bool(verdict.suspects) for verdict in verdicts),
        sum(args.n_vehicles - len(verdict.collaborators) for verdict in verdicts),
        int(sum(outcome.verifications[0] for outcome in outcomes)),
    )


def main(args: Args) -> None:
    torch.set_num_threads(args.threads)
    bank = SceneBank(open_source(args.scenes), load_detector(args.fusion), progress=False)
    episodes = [play(args, bank, scene) for scene in track(bank.source.names()[:: args.every], "playing")]
    title = f"{args.defender}, no attack, {args.scenes}"
    table = Table("scene", "frames", "with a flagged vehicle", "left out/frame", "verifications/frame", title=title)
    for e in [*episodes, Episode("all", *(sum(column) for column in zip(*map(figures, episodes), strict=True)))]:
        per_frame = (f"{x / e.frames:.2f}" for x in (e.left_out, e.verifications))
        table.add_row(e.scene, str(e.frames), str(e.flagged), *per_frame)
    Console().print(table)


def figures(e: Episode) -> tuple[int, ...]:
    return e.frames, e.flagged, e.left_out, e.verifications


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
