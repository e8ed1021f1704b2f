"""The first visit of a scene, and what it leaves on disk:

    python benchmarks/cold_start.py                           # five scenes' first steps, one whole scene; one thread
    python benchmarks/cold_start.py --scenes town/train --first 10

Each figure is of one environment with PRBI and no perturbation, in a cache that is empty at the beginning. `reading` is
what a frame of five maps costs once it lies on disk: unpacked, widened, and warped to the ego frame.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import tyro
from rich.console import Console
from rich.table import Table

from cp_env.detector import load_detector
from cp_env.scenes import open_source
from cp_env.world import SceneBank, World
from cp_env.world.episode import stack_maps


@dataclass(frozen=True)
class Args:
    """What is visited."""

    scenes: str = "town/test"
    first: int = 5  # scenes of which the first reset and step are timed; the next one is played whole
    rounds: int = 3  # of reading a whole scene; the best counts
    threads: int = 1  # of torch


def measure(args: Args, folder: Path) -> list[tuple[str, str]]:
    """What was timed, and the figures."""
    source, detector = open_source(args.scenes), load_detector()
    world = World(1, defender="prbi", bank=SceneBank(source, detector, folder, progress=False))
    names = source.names()
    visits = [seconds(lambda name=name: play(world, name, 1)) for name in names[: args.first]]  # type: ignore[misc]
    name = names[args.first]
    frames = source.load(name).n_frames
    cold, warm = (seconds(lambda: play(world, name, frames)) for _ in range(2))
    held = sum(path.stat().st_size for path in folder.glob(f"*/{name}/*.maps"))
    reading = min(seconds(lambda: read(SceneBank(source, detector, folder), name)) for _ in range(args.rounds))
    return [
        ("first reset and step of a scene, s", " ".join(f"{visit:.3f}" for visit in visits)),
        (f"{frames} frames of a cold scene, s", f"{cold:.2f}"),
        ("the same again, s", f"{warm:.2f}"),
        (f"its maps on disk ({world.settings.n_vehicles} vehicles), MB", f"{held / 1e6:.1f}"),
        ("reading, ms a frame", f"{1e3 * reading / frames:.2f}"),
    ]


def play(world: World, scene: str, frames: int) -> None:
    """The first frames of a scene without a perturbation."""
    world.reset([0], options={"scene": scene, "start": 0})
    for _ in range(frames):
        situation = world.situation()
        world.step(torch.zeros(*situation.attackers.shape, *situation.received.shape[2:]))


def read(bank: SceneBank, scene: str) -> None:
    """Every frame's maps, from disk."""
    episode = bank.episode(scene, 5, False)
    for t in range(episode.scene.n_frames):
        stack_maps([(episode, t)], "received")


def seconds(run: Callable[[], None]) -> float:
    """How long a call takes."""
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


def main(args: Args) -> None:
    """Print the figures."""
    torch.set_num_threads(args.threads)
    with tempfile.TemporaryDirectory(prefix="cp-env-cold-") as folder:
        figures = measure(args, Path(folder))
    table = Table("", "", title=f"numpy {np.__version__}, torch {torch.__version__}, {os.cpu_count()} cores", box=None)
    for row in figures:
        table.add_row(*row)
    Console().print(table)


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
