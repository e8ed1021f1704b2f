"""Views and steps of PGD a second, on whatever devices torch knows here, side by side:

    python benchmarks/devices.py                              # the CPU, one thread
    python benchmarks/devices.py --devices cpu cuda --batch 64
    python benchmarks/devices.py --clock processor            # the CPU alone, on a machine that does other things too

A view is a group fused, decoded and made into boxes; a step of PGD is a forward and a backward pass of one world's
joint attack by two of five vehicles. The maps are those of the first test scenes. Best of `rounds`, after one to warm
up; every round ends with its result on the CPU, so nothing is left running when the clock stops.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch
import tyro
from rich.console import Console
from rich.table import Table

import agents
from cp_env.detector import load_detector
from cp_env.scenes import open_source
from cp_env.scenes.clip import Clip
from cp_env.world.scene_cache import SceneBank
from cp_env.world.world import World

SCENES = 2
FRAMES = 2  # of a scene: one of grace, one that is attacked


@dataclass(frozen=True)
class Args:
    """What is timed, and where."""

    devices: tuple[str, ...] = ("cpu",)  # as torch spells them
    fusions: tuple[str, ...] = ("mean", "max", "sum", "v2vnet", "disconet")
    batch: int = 16  # worlds attacked together, and a third of the views asked together
    steps: int = 15  # of PGD
    rounds: int = 5
    threads: int = 1  # of torch, on the CPU
    clock: Literal["wall", "processor"] = "wall"
    out: Path | None = None  # where to write the figures too, as JSON


@dataclass(frozen=True)
class Speed:
    """Figures of one fusion on one device."""

    device: str
    fusion: str
    views: float  # a second
    steps: float  # a second


def measure(device: str, fusion: str, args: Args) -> Speed:
    """Time views and attacks. RuntimeError, torch's own, for a device that is not here."""
    source = Clip(open_source("town/test"), frames=FRAMES)
    bank = SceneBank(source, load_detector(fusion, device), progress=False)
    world = World(args.batch, defender="none", bank=bank, n_attackers=2, max_frames=FRAMES)
    names = source.names()
    for e in range(args.batch):
        world.reset([e], worlds=[e], options={"scene": names[e % SCENES], "start": 0})
    nothing = torch.zeros_like(world.situation().received[:, :2])
    world.step(nothing)
    situation = world.situation()
    rows = torch.arange(args.batch, device=situation.received.device).repeat_interleave(3)
    groups = torch.rand(3 * args.batch, 5, generator=torch.Generator().manual_seed(0)) < 0.6
    groups[:, 0] = True
    groups = groups.to(situation.received.device)
    attack_instance = agents.make("pgd", steps=args.steps)

    @torch.inference_mode()
    def verify() -> None:
        detector = situation.ego_detector()
        detector.detect(detector.perceive(situation.received, situation.coverage, rows, groups))

    def attack() -> None:
        attack_instance.reset(args.batch, np.random.default_rng(0))
        attack_instance.act(situation).cpu()

    return Speed(
        device,
        fusion,
        len(groups) / best(verify, args),
        args.batch * args.steps / best(attack, args),
    )


def best(work: Callable[[], None], args: Args) -> float:
    """Seconds of the quickest round."""
    clock = time.perf_counter if args.clock == "wall" else time.process_time
    work()
    taken = []
    for _ in range(args.rounds):
        start = clock()
        work()
        taken.append(clock() - start)
    return min(taken)


def name_of(device: str) -> str:
    """What torch calls the hardware."""
    kind = torch.device(device).type
    return str(torch.cuda.get_device_name(device)) if kind == "cuda" else kind


def main(args: Args) -> None:
    torch.set_num_threads(args.threads)
    speeds = [measure(device, fusion, args) for device in args.devices for fusion in args.fusions]
    table = Table("device", "fusion", "views a second", "steps of PGD a second", box=None, pad_edge=False)
    for speed in speeds:
        table.add_row(name_of(speed.device), speed.fusion, f"{speed.views:.0f}", f"{speed.steps:.0f}")
    Console(width=100).print(
        table, f"{args.batch} worlds of five vehicles, {args.threads} thread(s) on the CPU, {args.clock} time"
    )
    if args.out is not None:
        rows = [{**vars(speed), "hardware": name_of(speed.device)} for speed in speeds]
        args.out.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
