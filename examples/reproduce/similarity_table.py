"""Similarity of a group's view to the frame before, by the size of the group and the number of attackers in it.

    python examples/reproduce/similarity_table.py                                       # measure, print, draw
    python examples/reproduce/similarity_table.py --frames 6 --write FILE               # and calibrate PRBI's ε
    python examples/reproduce/similarity_table.py --frames 4 --write FILE --fusion max  # and so on

PRBI (Sec. 11.1) judges every group by one threshold, 0.35. Here the similarity, Eq. (5), of every group of five
vehicles to the benign view of the frame before is measured on the calibration scenes. PGD attacks jointly in k = 0 … 4
vehicles (Δ 0.3, 15 steps of 0.1). The threshold of a size is the one that errs least: it minimises the mean of the
share of benign groups that fail and the share of groups with an attacker that pass. The latter is averaged over the
numbers of attackers, so that each number has the same weight. FILE is defenders/thresholds/thresholds.json.
"""

from __future__ import annotations

import itertools
import json
import shlex
import sys
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import torch
import tyro
from rich.console import Console
from rich.progress import track
from rich.table import Table

import agents
from cp_env.detector import load_detector
from cp_env.metrics.intervals import Interval, t_interval
from cp_env.scenes.subset import SceneSubset
from cp_env.settings import Fusion
from cp_env.world.scene_cache import SceneBank
from cp_env.world.world import World
from defenders.protocol import Defender, Frame, Informed, Inspection, Query, Verdict
from defenders.thresholds.tables import write_thresholds

Key = tuple[int, int]  # group size, attackers in it


@dataclass
class Args:
    scenes: str = "town/calibration+junction/calibration"
    fusion: Fusion = "mean"
    n_scenes: int | None = None  # so many, spread evenly over them (all by default)
    n_vehicles: int = 5
    frames: int = 11  # of every scene, from a drawn one on; the first is the reference of the second
    attack: str = "pgd"
    seed: int = 0
    threads: int = 1
    out: Path = Path("out/similarity")
    write: Path | None = None  # thresholds go here, as the fusion's entry


class Surveyor(Defender, Informed):
    """An instrument, no defence: compares every group with the view of the benign vehicles in the frame before."""

    def reveal_attackers(self, attackers: frozenset[int]) -> None:
        self.attackers = frozenset(attackers)

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        self.benign = frozenset(range(n_vehicles)) - self.attackers
        numbers = range(n_vehicles)
        self.groups = [frozenset(g) for size in range(1, n_vehicles + 1) for g in itertools.combinations(numbers, size)]
        self.reference = None
        self.measured: list[tuple[Key, float]] = []

    def inspect(self, frame: Frame) -> Inspection:
        views = yield Query(self.groups)
        if self.reference is not None:
            for group, view in zip(self.groups, views, strict=True):
                key = len(group), len(group & self.attackers)
                self.measured.append((key, frame.similarity(view, self.reference)))
        self.reference = views[self.groups.index(self.benign)]
        return Verdict(self.benign, self.attackers)


def survey(args: Args) -> dict[Key, dict[str, list[float]]]:
    """Similarities by (size, attackers) and scene."""
    bank = SceneBank(SceneSubset(args.scenes, args.n_scenes), load_detector(args.fusion))
    found: dict[Key, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    jobs = list(itertools.product(bank.source.names(), range(args.n_vehicles)))
    for number, (name, k) in enumerate(track(jobs, f"surveying {args.fusion}")):
        world = World(
            1,
            defender=Surveyor(),
            bank=bank,
            n_vehicles=args.n_vehicles,
            n_attackers=k,
            grace_frames=0,
            max_frames=args.frames,
            fusion=args.fusion,
        )
        world.reset([np.random.SeedSequence([args.seed, number])], options={"scene": name})
        attack = agents.make(args.attack if k else "none")
        attack.reset(1, np.random.default_rng([args.seed, number]))
        for _ in range(args.frames):
            world.step(attack.act(world.situation()))
        (surveyor,) = world.defenders
        assert isinstance(surveyor, Surveyor)
        for key, value in surveyor.measured:
            found[key][name].append(value)
    return found


def pooled(found: dict[Key, dict[str, list[float]]], key: Key) -> np.ndarray:
    return np.concatenate(list(found[key].values()))


def threshold(found: dict[Key, dict[str, list[float]]], size: int) -> float:
    """The threshold that best separates benign groups of this size from groups with attackers."""
    benign = pooled(found, (size, 0))
    contaminated = [pooled(found, key) for key in sorted(found) if key[0] == size and key[1] > 0]
    grid = np.arange(0.02, 0.99, 0.01)
    errors = [(benign < e).mean() + np.mean([(group >= e).mean() for group in contaminated]) for e in grid]
    best = np.flatnonzero(np.isclose(errors, np.min(errors)))
    return round(float(grid[best].mean()), 2)  # the middle of the plateau


def report(found: dict[Key, dict[str, list[float]]], epsilon: dict[int, float], args: Args) -> None:
    sizes = range(1, args.n_vehicles + 1)
    table = Table(
        "group size",
        *(f"{k} attackers" for k in range(args.n_vehicles)),
        "ε",
        title=f"{args.fusion}: similarity to the frame before",
    )
    shares = Table(
        "group size", *(f"{k} attackers" for k in range(args.n_vehicles)), title="share that passes at 0.35 / at ε"
    )
    rows = []
    for size in sizes:
        cells, passing = [], []
        for attackers in range(args.n_vehicles):
            if (size, attackers) not in found:
                cells.append("–")
                passing.append("–")
                continue
            mean: Interval = t_interval([np.mean(values) for values in found[size, attackers].values()])
            values = pooled(found, (size, attackers))
            cells.append(f"{mean:.2f}")
            passing.append(f"{(values >= 0.35).mean():.2f} / {(values >= epsilon[size]).mean():.2f}")
            rows.append({"size": size, "attackers": attackers, "mean": mean.mean, "low": mean.low, "high": mean.high})
        table.add_row(str(size), *cells, f"{epsilon[size]:.2f}")
        shares.add_row(str(size), *passing)
    console = Console(width=150)
    console.print(table, shares, sep="\n")
    args.out.mkdir(parents=True, exist_ok=True)
    path = args.out / f"{args.fusion}.json"
    path.write_text(json.dumps({"rows": rows, "epsilon": epsilon}, indent=1) + "\n")
    console.print("drawn:", draw(found, epsilon, args))


def draw(found: dict[Key, dict[str, list[float]]], epsilon: dict[int, float], args: Args) -> Path:
    figure, axes = plt.subplots(
        1, args.n_vehicles, figsize=(3.2 * args.n_vehicles, 3.4), sharey=True, layout="constrained"
    )
    colours = plt.get_cmap("viridis")(np.linspace(0, 0.9, args.n_vehicles))
    for size, axis in enumerate(axes, start=1):
        for attackers in range(args.n_vehicles):
            if (size, attackers) in found:
                values, label = pooled(found, (size, attackers)), f"{attackers} attackers"
                axis.hist(
                    values,
                    np.linspace(0, 1, 26),
                    density=True,
                    histtype="step",
                    lw=1.8,
                    color=colours[attackers],
                    label=label,
                )
        axis.axvline(0.35, color="grey", ls=":", label="0.35 (paper)")
        axis.axvline(epsilon[size], color="crimson", ls="--", label="calibrated ε")
        axis.set(title=f"groups of {size}", xlabel="Jaccard similarity")
    axes[0].set_ylabel("density")
    axes[-1].legend(fontsize=8)
    path = args.out / f"{args.fusion}.png"
    figure.savefig(path, dpi=110)
    return path


def main(args: Args) -> None:
    torch.set_num_threads(args.threads)
    found = survey(args)
    epsilon = {size: threshold(found, size) for size in range(1, args.n_vehicles + 1)}
    report(found, epsilon, args)
    if args.write:
        source = (
            f"{args.n_scenes or 'all'} scenes of {args.scenes}, detector {load_detector(args.fusion).digest}, "
            f"{args.attack}, {args.frames} frames a scene"
        )
        write_thresholds(args.write, args.fusion, epsilon, source=source, command=shlex.join(["python", *sys.argv]))


if __name__ == "__main__":
    main(tyro.cli(Args))
