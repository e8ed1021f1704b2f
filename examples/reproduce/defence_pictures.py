"""Fig. 2 of the paper: ground truth and what the ego sees, unattacked, attacked and defended, one row a fusion.

    python examples/reproduce/defence_pictures.py
    python examples/reproduce/defence_pictures.py --scene test-urban-00 --fusions v2vnet --defenders none prbi bayes

As in the paper, ground truth is green and predictions are red. Two of five vehicles attack from the second frame on
(Sec. 11.1: PGD, Δ = 0.3, 15 steps of 0.1). Shown is one later frame, after PRBI's first verdicts. The seed decides the
scene, its start and the attackers; nothing was selected. The boxes are those the ego acts on. What is played is kept in
`out`, a file a panel: the same command goes on where a killed run stopped.
"""

from __future__ import annotations

import json
import shlex
import sys
import zlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import torch
import tyro
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.lines import Line2D
from rich.console import Console
from rich.progress import track

from cp_env import evaluation
from cp_env.evaluation.plan.files import write_atomically
from cp_env.geometry.planar import corners
from cp_env.rendering.camera import Camera
from cp_env.rendering.frame import wrong_rows
from cp_env.scenes import open_source
from cp_env.settings import Fusion
from defenders.registry import Spec
from examples.reproduce.defence_tables import N_ATTACKERS, make_attack

TRUTH, SEEN, ATTACKER, BENIGN = "tab:green", "tab:red", "black", "tab:blue"
TITLES = {"none": "no defence", "prbi": "PRBI"}

Panel = dict[str, Any]  # boxes, points and numbers of one picture, fit for JSON


@dataclass(frozen=True)
class Args:
    """What is shown."""

    scenes: str = "town/test"
    scene: str = "test-intersection-00"
    frame: int = 8  # of the episode
    fusions: tuple[Fusion, ...] = ("mean", "max", "sum", "v2vnet", "disconet")
    attack: str = "pgd"
    defenders: tuple[str, ...] = ("none", "prbi")  # against the attack; the first column is unattacked
    seed: int = 0
    threads: int = 1
    out: Path = Path("out/defence_pictures")


def panels(args: Args) -> dict[tuple[str, str], Panel]:
    """By fusion and title of the column: played, or read where they are kept."""
    attack = Spec.parse(args.attack).name
    columns = [("no attack", "none", "none")]
    columns += [(f"{attack.upper()}, {TITLES.get(one, one)}", one, args.attack) for one in args.defenders]
    jobs = [(fusion, *column) for fusion in args.fusions for column in columns]
    made: dict[tuple[str, str], Panel] = {}
    for fusion, title, defender, attack in track(jobs, "playing", console=Console(stderr=True)):
        conditions = evaluation.Conditions(args.scenes, (args.scene,), args.frame + 1, fusion=fusion)
        run = evaluation.Run(defender, attack, N_ATTACKERS, args.seed, conditions.names)
        bank = evaluation.open_bank(conditions)
        key = zlib.crc32(run.slug(conditions, bank.detector.digest).encode())
        path = args.out / "panels" / f"{fusion}-{defender}-{attack}-{key:08x}.json".replace(":", "-")
        if not path.exists():
            write_atomically(path, json.dumps(play(run, conditions)) + "\n")
        made[fusion, title] = json.loads(path.read_text())
    return made


def play(run: evaluation.Run, conditions: evaluation.Conditions) -> Panel:
    """The last frame of the episode."""
    rollout = evaluation.Rollout(run, conditions, evaluation.open_bank(conditions), make_attack(run.attack))
    camera = Camera(rollout.world)
    for _ in range(conditions.frames):
        camera.record(rollout.step())
    picture = camera.picture(0)
    tall = np.concatenate(picture.points)
    tall = tall[(tall[:, 2] > 0.3) & (np.abs(tall[:, :2]) <= picture.extent).all(axis=1)]
    ghosts, missed = wrong_rows(picture.output.boxes, picture.truth)
    return {
        "points": np.unique(np.round(tall[:, :2] * 4) / 4, axis=0).tolist(),  # to a quarter of a metre
        "places": picture.places.round(2).tolist(),
        "truth": picture.truth.round(2).tolist(),
        "seen": np.round(picture.output.boxes, 2).tolist(),
        "attackers": sorted(picture.attackers) if run.attack != "none" else [],
        "fused": sorted(picture.collaborators),
        "ghosts": len(ghosts),
        "missed": len(missed),
        "extent": picture.extent,
    }


def draw(made: dict[tuple[str, str], Panel], path: Path) -> Path:
    """Fusions down, conditions across."""
    fusions, titles = (list(dict.fromkeys(key[axis] for key in made)) for axis in (0, 1))
    size = (3.9 * len(titles) + 0.4, 4.1 * len(fusions) + 0.9)
    figure, axes = plt.subplots(
        len(fusions), len(titles), figsize=size, squeeze=False, sharex=True, sharey=True, layout="constrained"
    )
    for row, fusion in enumerate(fusions):
        for column, title in enumerate(titles):
            show(axes[row, column], made[fusion, title], f"{fusion}, {title}")
    for axis in axes[-1]:
        axis.set_xlabel("x in the ego's frame (m)")
    for axis in axes[:, 0]:
        axis.set_ylabel("y (m)")
    handles = [
        Line2D([], [], color=TRUTH, label="ground truth"),
        Line2D([], [], color=SEEN, label="predictions"),
        Line2D([], [], ls="none", marker="o", color=BENIGN, label="benign vehicle"),
        Line2D([], [], ls="none", marker="X", color=ATTACKER, label="attacker"),
        Line2D([], [], ls="none", marker="o", mfc="none", mec="0.4", ms=12, label="fused"),
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles), frameon=False)
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return path


def show(axis: Axes, panel: Panel, title: str) -> None:
    """One panel."""
    points = np.array(panel["points"]).reshape(-1, 2)
    axis.scatter(points[:, 0], points[:, 1], s=0.6, color="0.75", linewidths=0)
    for name, colour, width in (("truth", TRUTH, 2.2), ("seen", SEEN, 1.3)):
        axis.add_collection(PolyCollection(list(outlines(panel[name])), facecolors="none", edgecolors=colour, lw=width))
    for number, (x, y) in enumerate(panel["places"]):
        attacker = number in panel["attackers"]
        axis.plot(
            x,
            y,
            "X" if attacker else "o",
            color=ATTACKER if attacker else BENIGN,
            ms=7 if attacker else 5,
            clip_on=True,
        )
        if number in panel["fused"]:
            axis.plot(x, y, "o", mfc="none", mec="0.4", ms=12)
    axis.set_title(f"{title}\n{panel['missed']} missed, {panel['ghosts']} ghosts", fontsize=10)
    axis.set(xlim=(-panel["extent"], panel["extent"]), ylim=(-panel["extent"], panel["extent"]), aspect="equal")


def outlines(boxes: Sequence[Sequence[float]]) -> Float[np.ndarray, "K 4 2"]:
    """Corners of boxes, m."""
    return corners(np.array(boxes, dtype=np.float64).reshape(-1, 5))


def main(args: Args) -> None:
    torch.set_num_threads(args.threads)
    if args.scene not in open_source(args.scenes).names():
        raise ValueError(f"no scene {args.scene!r}; known: {', '.join(open_source(args.scenes).names())}")
    made = panels(args)
    about = {"command": shlex.join(["python", *sys.argv]), **json.loads(json.dumps(asdict(args), default=str))}
    rows = [{"fusion": fusion, "condition": title, **panel} for (fusion, title), panel in made.items()]
    write_atomically(args.out / "defence_pictures.json", json.dumps({"about": about, "panels": rows}) + "\n")
    Console().print("written:", args.out / "defence_pictures.json", draw(made, args.out / "defence_pictures.png"))


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
