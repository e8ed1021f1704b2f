"""Calibrate the thresholds of ROBOSAC and PASAC against the ego-only view, by size of the group.

    python examples/calibrate_pasac.py                                                      # measure, print, draw
    python examples/calibrate_pasac.py --frames 4 --write defenders/thresholds              # and store "calibrated"
    python examples/calibrate_pasac.py --frames 3 --write defenders/thresholds --fusion max # and so on

ROBOSAC and PASAC compare the view of a group that contains the ego with the ego-only view. They compare the boxes by
their Jaccard similarity (published threshold 0.3), or the score maps by their consistency (CCLoss, published threshold
0.08, made for segmentation). Here both scores are measured on the calibration scenes. The ego is benign, and PGD
attacks jointly in k = 0 … n - 1 of the other vehicles (Δ 0.3, 15 steps of 0.1). The threshold of a size is the one that
errs least: it minimises the mean of the share of benign groups that fail and the share of groups with an attacker that
pass. The latter is averaged over the numbers of attackers, so that each number has the same weight. Groups of one are
single vehicles other than the ego. PASAC verifies those with trust_ego=False only.
"""

from __future__ import annotations

import itertools
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
from cp_env.metrics.intervals import t_interval
from cp_env.scenes.subset import SceneSubset
from cp_env.settings import Fusion
from cp_env.world.scene_cache import SceneBank
from cp_env.world.world import World
from defenders.protocol import Defender, Frame, Informed, Inspection, Query, Verdict
from defenders.thresholds.tables import EGO_ONLY, write_thresholds

Key = tuple[int, int]  # size of the group, attackers in it
Found = dict[Key, dict[str, list[float]]]  # scores by scene
PAPER = {"agreement": 0.08, "similarity": 0.3}


@dataclass
class Args:
    scenes: str = "town/calibration+junction/calibration"
    fusion: Fusion = "mean"
    n_scenes: int | None = None  # so many, spread evenly over them (all by default)
    n_vehicles: int = 5
    frames: int = 6  # of every scene, from a drawn one on
    attack: str = "pgd"
    seed: int = 0
    threads: int = 1
    out: Path = Path("out/pasac")
    write: Path | None = None  # folder of ego_agreement.json and ego_similarity.json, for the fusion's entries


class Surveyor(Defender, Informed):
    """An instrument, no defence: compares groups with the ego, and single other vehicles, with the ego-only view."""

    def reveal_attackers(self, attackers: frozenset[int]) -> None:
        self.attackers = frozenset(attackers)

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        others = range(1, n_vehicles)
        teams = [frozenset({0, *g}) for size in others for g in itertools.combinations(others, size)]
        self.groups = [*teams, *(frozenset({i}) for i in others)]
        self.measured: list[tuple[Key, dict[str, float]]] = []

    def inspect(self, frame: Frame) -> Inspection:
        ego_only, *views = yield Query([{0}, *self.groups])
        for group, view in zip(self.groups, views, strict=True):
            scores = {score: getattr(frame, score)(view, ego_only) for score in PAPER}
            self.measured.append(((len(group), len(group & self.attackers)), scores))
        return Verdict({0})


def survey(args: Args) -> dict[str, Found]:
    """Both scores by (size, attackers) and scene."""
    bank = SceneBank(SceneSubset(args.scenes, args.n_scenes), load_detector(args.fusion))
    found: dict[str, Found] = {score: defaultdict(lambda: defaultdict(list)) for score in PAPER}
    jobs = list(itertools.product(bank.source.names(), range(args.n_vehicles)))
    for number, (name, k) in enumerate(track(jobs, f"surveying {args.fusion}")):
        rng = np.random.default_rng([args.seed, number])
        attackers = tuple(sorted((1 + rng.permutation(args.n_vehicles - 1)[:k]).tolist()))
        world = World(
            1,
            defender=Surveyor(),
            bank=bank,
            n_vehicles=args.n_vehicles,
            attackers=attackers,
            grace_frames=0,
            max_frames=args.frames,
            fusion=args.fusion,
        )
        world.reset([np.random.SeedSequence([args.seed, number])], options={"scene": name})
        attack = agents.make(args.attack if k else "none")
        attack.reset(1, rng)
        for _ in range(args.frames):
            world.step(attack.act(world.situation()))
        (surveyor,) = world.defenders
        assert isinstance(surveyor, Surveyor)
        for key, scores in surveyor.measured:
            for score, value in scores.items():
                found[score][key][name].append(value)
    return found


def pooled(found: Found, key: Key) -> np.ndarray:
    return np.concatenate(list(found[key].values()))


def errors(found: Found, size: int, epsilon: float) -> tuple[float, float]:
    """Shares of benign groups that fail and of groups with an attacker that pass, averaged over k."""
    contaminated = [pooled(found, key) for key in sorted(found) if key[0] == size and key[1] > 0]
    benign_fail = (pooled(found, (size, 0)) <= epsilon).mean()
    return float(benign_fail), float(np.mean([(x > epsilon).mean() for x in contaminated]))


def threshold(found: Found, size: int) -> float:
    """The threshold that best separates benign groups of this size from groups with attackers."""
    values = np.concatenate([pooled(found, key) for key in found if key[0] == size])
    grid = np.linspace(values.min(), values.max(), 201)[:-1]
    wrong = np.array([sum(errors(found, size, e)) for e in grid])
    best = np.flatnonzero(np.isclose(wrong, wrong.min()))
    return round(float(grid[best].mean()), 4)  # the middle of the plateau


def table(score: str, found: Found, epsilon: dict[int, float], args: Args) -> Table:
    attackers = range(args.n_vehicles)
    title = f"{args.fusion}: {score} to the ego-only view; errors: benign groups that fail / others that pass"
    shown = Table(
        "group", *(f"{k} attackers" for k in attackers), "ε", "errors at ε", f"errors at {PAPER[score]}", title=title
    )
    for size in sorted(epsilon):
        means = {k: [np.mean(x) for x in found[size, k].values()] for k in attackers if (size, k) in found}
        cells = [f"{t_interval(means[k]):.3f}" if k in means else "–" for k in attackers]
        rates = ["{:.2f} / {:.2f}".format(*errors(found, size, e)) for e in (epsilon[size], PAPER[score])]
        shown.add_row(str(size), *cells, f"{epsilon[size]:.3f}", *rates)
    return shown


def draw(found: dict[str, Found], epsilon: dict[str, dict[int, float]], args: Args) -> Path:
    sizes = range(2, args.n_vehicles + 1)
    figure, grid = plt.subplots(len(PAPER), len(sizes), figsize=(3.2 * len(sizes), 6.5), layout="constrained")
    colours = plt.get_cmap("viridis")(np.linspace(0, 0.9, args.n_vehicles))
    for (score, by_key), row in zip(found.items(), grid, strict=True):
        edges = np.linspace(0, max(pooled(by_key, key).max() for key in by_key) * 1.02, 26)
        for size, axis in zip(sizes, row, strict=True):
            for k in range(args.n_vehicles):
                if (size, k) in by_key:
                    values = pooled(by_key, (size, k))
                    axis.hist(
                        values, edges, density=True, histtype="step", lw=1.8, color=colours[k], label=f"{k} attackers"
                    )
            axis.axvline(PAPER[score], color="grey", ls=":", label="as published")
            axis.axvline(epsilon[score][size], color="crimson", ls="--", label="calibrated")
            axis.set(title=f"the ego and {size - 1} more", xlabel=f"{score} to the ego-only view")
        row[0].set_ylabel("density")
    handles, labels = grid[-1, -1].get_legend_handles_labels()  # the panel that has every number of attackers
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), fontsize=9)
    args.out.mkdir(parents=True, exist_ok=True)
    path = args.out / f"ego_only-{args.fusion}.png"
    figure.savefig(path, dpi=110)
    return path


def main(args: Args) -> None:
    torch.set_num_threads(args.threads)
    found = survey(args)
    sizes = range(1, args.n_vehicles + 1)
    epsilon = {score: {size: threshold(by_key, size) for size in sizes} for score, by_key in found.items()}
    console = Console(width=170)
    console.print(*(table(score, found[score], epsilon[score], args) for score in PAPER), sep="\n")
    console.print("drawn:", str(draw(found, epsilon, args)))
    source = (
        f"{args.n_scenes or 'all'} scenes of {args.scenes}, detector {load_detector(args.fusion).digest}, "
        f"{args.attack}, {args.frames} frames a scene"
    )
    command = shlex.join(["python", *sys.argv])
    for score in PAPER if args.write is not None else ():
        path = args.write / EGO_ONLY[score].name  # type: ignore[operator]
        write_thresholds(path, args.fusion, epsilon[score], source=source, command=command)


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
