"""Similarity of consecutive outputs, without and under attack, by the speed of the ego.

    python examples/reproduce/similarity_speed.py
    python examples/reproduce/similarity_speed.py --scenes junction/test

PRBI rests on two premises: without an attack consecutive outputs resemble each other (0.8 and more, Sec. 8), and under
attack the output does not resemble the one before (0.3 at most). A parked scene flatters the first. Here every scene is
played from a start that is the same for all runs, once without an attack and once with PGD in k of five vehicles
(Δ 0.3, 15 steps of 0.1). The view of all vehicles is compared, Eq. (5), with the view of the benign vehicles in the
frame before. Each comparison goes to the bin of the ego's speed between the two frames; the intervals are over scenes.
"""

from __future__ import annotations

import json
import zlib
from dataclasses import dataclass
from itertools import pairwise, product
from pathlib import Path

import numpy as np
import torch
import tyro
from jaxtyping import Float
from rich.console import Console
from rich.progress import track
from rich.table import Table

import agents
from cp_env.detector import load_detector
from cp_env.metrics.intervals import t_interval
from cp_env.scenes import open_source
from cp_env.settings import Fusion
from cp_env.world.scene_cache import SceneBank
from cp_env.world.world import World
from defenders.protocol import Defender, Frame, Informed, Inspection, Query, Verdict

EDGES = (0.0, 0.3, 3.0, 5.0, 7.0, float("inf"))  # m/s
BENIGN, ATTACKED = 0.8, 0.3  # the premises


@dataclass
class Args:
    scenes: str = "town/test"
    n_scenes: int | None = None  # the first so many (all by default)
    start: int = 10  # frame of the scene that is the first
    frames: int = 80  # of every scene without an attack
    attacked: int = 20  # of every scene with one
    attackers: tuple[int, ...] = (2,)
    attack: str = "pgd"
    n_vehicles: int = 5
    fusion: Fusion = "mean"
    seed: int = 0
    threads: int = 1
    json: Path | None = None  # where to write the comparisons too


@dataclass(frozen=True)
class Comparison:
    """The output of a frame beside the benign one of the frame before."""

    scene: str
    k: int
    speed: float  # of the ego, m/s
    similarity: float


class Surveyor(Defender, Informed):
    """An instrument, no defence: compares the view of all with the view of the benign vehicles in the frame before."""

    def reveal_attackers(self, attackers: frozenset[int]) -> None:
        self.attackers = frozenset(attackers)

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        self.benign = frozenset(range(n_vehicles)) - self.attackers
        self.reference = None
        self.measured: list[float] = []

    def inspect(self, frame: Frame) -> Inspection:
        (view,) = yield Query([self.benign], verification=False)
        if self.reference is not None:
            self.measured.append(frame.similarity(frame.seen, self.reference))
        self.reference = view
        return Verdict(self.benign, self.attackers)


def play(args: Args, bank: SceneBank, name: str, k: int) -> list[Comparison]:
    """One scene under an attack by k vehicles, or under none."""
    entropy = [args.seed, zlib.crc32(name.encode()), k]
    world = World(
        1,
        defender=Surveyor(),
        bank=bank,
        n_vehicles=args.n_vehicles,
        n_attackers=k,
        grace_frames=0,
        fusion=args.fusion,
    )
    world.reset([np.random.SeedSequence(entropy)], options={"scene": name, "start": args.start})
    attack = agents.make(args.attack if k else "none")
    attack.reset(1, [np.random.default_rng(entropy)])
    scene = bank.source.load(name)
    frames = range(args.start, min(args.start + (args.attacked if k else args.frames), scene.n_frames))
    for _ in frames:
        world.step(attack.act(world.situation()))
    (surveyor,) = world.defenders
    assert isinstance(surveyor, Surveyor)
    place = scene.pose[:, scene.connected[0], :2]
    speed = [float(np.linalg.norm(place[b] - place[a])) / scene.dt for a, b in pairwise(frames)]
    return [Comparison(name, k, v, s) for v, s in zip(speed, surveyor.measured, strict=True)]


def by_scene(found: list[Comparison], k: int, low: float, high: float) -> list[Float[np.ndarray, " T"]]:
    """The similarities of a bin of speeds, an array for every scene that has any."""
    kept = [one for one in found if one.k == k and low <= one.speed < high]
    return [np.array([o.similarity for o in kept if o.scene == name]) for name in sorted({o.scene for o in kept})]


def row(found: list[Comparison], args: Args, low: float, high: float) -> list[str]:
    """Mean over scenes with its interval and the share that keeps the premise, without and with k attackers."""
    cells = []
    for k in (0, *args.attackers):
        scenes = by_scene(found, k, low, high)
        if not scenes:
            cells += ["–", "–", "0 in 0"]
            continue
        values = np.concatenate(scenes)
        keeps = values <= ATTACKED if k else values >= BENIGN
        mean = t_interval([scene.mean() for scene in scenes])
        cells += [f"{mean:.2f}", f"{keeps.mean():.2f}", f"{len(values)} in {len(scenes)}"]
    return cells


def table(found: list[Comparison], args: Args) -> Table:
    columns = ["ego's speed, m/s", "no attack", f"≥ {BENIGN}", "frames in scenes"]
    for k in args.attackers:
        columns += [f"{args.attack}, k = {k}", f"≤ {ATTACKED}", "frames in scenes"]
    shown = Table(*columns, title=f"{args.scenes}, {args.fusion}: similarity to the benign output before")
    for low, high in pairwise(EDGES):
        shown.add_row(f"{low:g} … {high:g}" if np.isfinite(high) else f"{low:g} …", *row(found, args, low, high))
    shown.add_row("all", *row(found, args, 0.0, np.inf))
    return shown


def main(args: Args) -> None:
    torch.set_num_threads(args.threads)
    bank = SceneBank(open_source(args.scenes), load_detector(args.fusion))
    jobs = list(product(bank.source.names()[: args.n_scenes], (0, *args.attackers)))
    found = [one for name, k in track(jobs, "surveying") for one in play(args, bank, name, k)]
    Console(width=150).print(table(found, args))
    if args.json is not None:
        args.json.write_text(json.dumps([vars(one) for one in found], indent=1) + "\n")


if __name__ == "__main__":
    main(tyro.cli(Args))
