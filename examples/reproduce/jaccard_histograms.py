"""Sec. 8 and Fig. 6 of the paper: similarity of the ego's outputs in consecutive frames, benign and attacked.

    python examples/reproduce/jaccard_histograms.py                                              # a few minutes
    python examples/reproduce/jaccard_histograms.py --n-scenes 4 --frames 16 --fusions mean max sum v2vnet disconet

For every kind of scene (urban, suburban, intersection) and fusion, histograms of the Jaccard similarity, Eq. (5), of
the outputs of consecutive frames. The upper bound fuses all vehicles without an attack. The lower bound is the ego
alone. BIM, C&W and PGD (Sec. 11.1: Δ = 0.3, 15 steps of 0.1) attack in two of five vehicles, drawn anew for each scene.
Both frames of a pair are attacked, as we read the paper. `to_benign` is the similarity of the attacked frame to the
benign view of the frame before, which is what a defence compares. The table has the mean over scenes with its 95 %
interval (Gaffke). What is played is kept in `out`: the same command goes on where a killed run stopped.
"""

from __future__ import annotations

import itertools
import json
import shlex
import sys
import zlib
from dataclasses import asdict, dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import torch
import tyro
from matplotlib.lines import Line2D
from rich.console import Console
from rich.progress import track
from rich.table import Table

import agents
from cp_env.detector.registry import open_detector
from cp_env.metrics.shares import share_interval
from cp_env.metrics.similarity import view_similarity_many
from cp_env.rendering import style
from cp_env.scenes import open_source
from cp_env.settings import Fusion, Precision
from cp_env.types import SceneSource
from cp_env.world.scene_cache import SceneBank
from cp_env.world.world import World

CONDITIONS = {"upper bound": "none", "lower bound": "none", "BIM": "bim", "C&W": "cw", "PGD": "pgd"}
KINDS = {"urban": style.BLUE, "suburban": style.ORANGE, "intersection": style.GREEN}  # and their colours
Values = dict[str, list[float]]  # similarities to the output, and to the benign view, of the frame before
Found = dict[tuple[str, str, str], list[Values]]  # by fusion, condition and kind; one entry a scene


@dataclass(frozen=True)
class Args:
    """What is played."""

    scenes: str = "town/test"
    n_scenes: int = 2  # of each kind
    frames: int = 11  # of each scene, from its first on
    fusions: tuple[Fusion, ...] = ("v2vnet",)  # the paper's backbone; also mean, max, sum, disconet
    n_vehicles: int = 5
    n_attackers: int = 2
    precision: Precision = "float32"  # of the detector's maps, fusion and decoder
    seed: int = 0
    threads: int = 1
    out: Path = Path("out/jaccard")


def survey(args: Args) -> Found:
    """Every fusion and condition on every scene; what is on disk already is read."""
    source = open_source(args.scenes)
    chosen = [(kind, name) for kind in KINDS for name in of_kind(source, kind)[: args.n_scenes]]
    found: Found = {}
    for fusion in args.fusions:
        bank = SceneBank(source, open_detector(fusion=fusion, precision=args.precision), progress=False)
        jobs = list(itertools.product(CONDITIONS, chosen))
        for condition, (kind, name) in track(jobs, fusion, console=Console(stderr=True)):
            key = (
                f"{source.digest} {bank.detector.digest} {args.n_vehicles} {args.n_attackers} {args.frames} {args.seed}"
            )
            path = (
                args.out
                / "scenes"
                / f"{fusion}-{condition}-{name}-{zlib.crc32(key.encode()):08x}.json".replace(" ", "-")
            )
            if not path.exists():
                values = play(bank, fusion, condition, name, args)
                path.parent.mkdir(parents=True, exist_ok=True)
                path.with_suffix(".part").write_text(json.dumps(values))
                path.with_suffix(".part").rename(path)
            found.setdefault((fusion, condition, kind), []).append(json.loads(path.read_text()))
    return found


def of_kind(source: SceneSource, kind: str) -> list[str]:
    return [name for name in source.names() if source.load(name).kind == kind]


def play(bank: SceneBank, fusion: Fusion, condition: str, name: str, args: Args) -> Values:
    """One scene under one condition: the similarity of every output to the frame before."""
    seed = [args.seed, zlib.crc32(name.encode())]  # the same attackers whatever the fusion and the attack
    ego_only, attack = condition == "lower bound", CONDITIONS[condition]
    world = World(
        1,
        defender="ego_only" if ego_only else "none",
        bank=bank,
        fusion=fusion,
        n_vehicles=args.n_vehicles,
        n_attackers=args.n_attackers,
        grace_frames=0,
        max_frames=args.frames,
    )
    world.reset([np.random.SeedSequence(seed)], options={"scene": name, "start": 0})
    attack_instance = agents.make(attack)
    attack_instance.reset(1, np.random.default_rng(seed).spawn(1))
    outcomes = [world.step(attack_instance.act(world.situation())) for _ in range(args.frames)]
    output = [outcome.output[0] for outcome in outcomes]
    benign = output if ego_only else [outcome.clean[0] for outcome in outcomes]
    return {
        "to_output": view_similarity_many(list(itertools.pairwise(output))).tolist(),
        "to_benign": view_similarity_many(list(zip(benign[:-1], output[1:], strict=True))).tolist(),
    }


def table(found: Found, args: Args) -> Table:
    """Mean similarity of consecutive outputs, over scenes; the last column pools the kinds."""
    made = Table("fusion", "condition", *KINDS, "all", "all, to the benign frame before", box=None, pad_edge=False)
    for fusion, condition in itertools.product(args.fusions, CONDITIONS):
        scenes = {kind: found[fusion, condition, kind] for kind in KINDS}
        pooled = [scene for kind in KINDS for scene in scenes[kind]]
        cells = [share_interval([np.mean(scene["to_output"]) for scene in part]) for part in (*scenes.values(), pooled)]
        cells.append(share_interval([np.mean(scene["to_benign"]) for scene in pooled]))
        made.add_row(fusion, condition, *(f"{cell:.2f}" for cell in cells))
    return made


@style.plot_style()
def draw(found: Found, args: Args, path: Path) -> Path:
    """A row a fusion, a column a condition, a line a kind of scene."""
    size = (style.PAGE, 0.6 + 1.8 * len(args.fusions))
    figure, axes = plt.subplots(
        len(args.fusions), len(CONDITIONS), figsize=size, sharex=True, sharey=True, squeeze=False, layout="constrained"
    )
    bins = np.linspace(0, 1, 21)
    for (row, fusion), (column, condition) in itertools.product(enumerate(args.fusions), enumerate(CONDITIONS)):
        axis = axes[row, column]
        for (kind, colour), dashes in zip(KINDS.items(), ("-", "--", ":"), strict=False):
            values = np.concatenate([scene["to_output"] for scene in found[fusion, condition, kind]])
            share = np.full(len(values), 1 / len(values))
            axis.hist(values, bins, weights=share, histtype="step", lw=1.6, ls=dashes, color=colour, label=kind)
        if row == 0:
            axis.set_title(condition)
        axis.set_xlim(-0.02, 1.02)
        axis.set_xticks([0, 0.5, 1], ["0", "0.5", "1"])
    for axis, fusion in zip(axes[:, 0], args.fusions, strict=True):
        axis.set_ylabel(f"{fusion}\nshare of frame pairs")
    figure.supxlabel("Jaccard similarity of consecutive outputs", fontsize=9)
    handles = [
        Line2D([], [], color=c, ls=d, label=k) for (k, c), d in zip(KINDS.items(), ("-", "--", ":"), strict=False)
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=len(KINDS))
    style.save_plot(figure, path)
    plt.close(figure)
    return path


def main(args: Args) -> None:
    torch.set_num_threads(args.threads)
    found = survey(args)
    console = Console(width=150)
    console.print(table(found, args), highlight=False)
    about = {"command": shlex.join(["python", *sys.argv]), **json.loads(json.dumps(asdict(args), default=str))}
    rows = [
        {"fusion": fusion, "condition": condition, "kind": kind, "scenes": scenes}
        for (fusion, condition, kind), scenes in found.items()
    ]
    (args.out / "jaccard.json").write_text(json.dumps({"about": about, "rows": rows}, indent=1) + "\n")
    console.print("written:", args.out / "jaccard.json", draw(found, args, args.out / "jaccard.png"))


if __name__ == "__main__":
    main(tyro.cli(Args))
