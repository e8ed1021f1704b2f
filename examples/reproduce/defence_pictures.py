"""Fig. 2 of the paper: ground truth and what the ego sees, unattacked, attacked and defended, one row a fusion.

    python examples/reproduce/defence_pictures.py
    python examples/reproduce/defence_pictures.py --scene test-urban-00 --fusions v2vnet --defenders none prbi bayes

The paper has ground truth in green and predictions in red. Here a colour and a shape mean the same as in the films:
blue boxes are vehicles that were found, filled yellow ones were missed, crossed-out purple ones are ghosts, and the
colour-blind tell them apart. Two of five vehicles attack from the second frame on
(Sec. 11.1: PGD, Δ = 0.3, 15 steps of 0.1). Shown is one later frame, after PRBI's first verdicts. The seed decides the
scene, its start and the attackers; nothing was selected. The boxes are those the ego acts on. What is played is kept in
`out`, a file a panel: the same command goes on where a killed run stopped.
"""

from __future__ import annotations

import json
import shlex
import sys
import zlib
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
from matplotlib.patches import Patch
from rich.console import Console
from rich.progress import track

from agents.arena.entries import make_attack
from cp_env import evaluation
from cp_env.evaluation.plan.files import write_atomically
from cp_env.geometry.planar import corners
from cp_env.rendering import style
from cp_env.rendering.camera import Camera
from cp_env.rendering.picture import wrong_rows
from cp_env.scenes import open_source
from cp_env.settings import Fusion
from defenders.registry import Spec

FOUND, MISSED, GHOST = style.LIGHT.found, style.LIGHT.missed, style.LIGHT.ghost
TRUTH, ATTACKER = style.GRID, style.LIGHT.attacker
N_ATTACKERS = 2
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


@style.plot_style()
def draw(made: dict[tuple[str, str], Panel], path: Path) -> Path:
    """Fusions down, conditions across."""
    fusions, titles = (list(dict.fromkeys(key[axis] for key in made)) for axis in (0, 1))
    height = (style.PAGE - 0.9) / len(titles) + 0.2
    figure, axes = plt.subplots(
        len(fusions),
        len(titles),
        figsize=(style.PAGE, height * len(fusions) + 0.8),
        squeeze=False,
        sharex=True,
        sharey=True,
        layout="constrained",
    )
    for row, fusion in enumerate(fusions):
        for column, title in enumerate(titles):
            show(axes[row, column], made[fusion, title], title if row == 0 else "")
        axes[row, 0].set_ylabel(f"{fusion}\ny (m)")
    for axis in axes[-1]:
        axis.set_xlabel("x in the ego's frame (m)")
    disc: dict[str, Any] = {"ls": "none", "marker": "o", "mec": style.BLACK}
    handles = [
        Patch(fc=TRUTH, ec=style.GREY, label="true vehicle"),
        Patch(fc="none", ec=FOUND, lw=1.6, label="perceived"),
        Patch(fc=MISSED, ec=style.BLACK, label="missed"),
        Patch(fc="none", ec=GHOST, hatch="xx", label="ghost"),
        Line2D([], [], mfc=style.BLACK, ms=5, label="fused", **disc),
        Line2D([], [], mfc="white", ms=5, label="not fused", **disc),
        Line2D([], [], **(disc | {"mec": ATTACKER}), mfc="white", mew=3, ms=9, label="attacker"),
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles), columnspacing=1.2)
    style.save_plot(figure, path)
    plt.close(figure)
    return path


def show(axis: Axes, panel: Panel, title: str) -> None:
    """One panel: a colour and a shape for each kind of box, as in the films."""
    points = np.array(panel["points"]).reshape(-1, 2)
    axis.scatter(points[:, 0], points[:, 1], s=0.4, color=style.LIGHT.others, linewidths=0)
    truth, seen = (np.array(panel[name], dtype=np.float64).reshape(-1, 5) for name in ("truth", "seen"))
    ghosts, missed = (sorted(rows) for rows in wrong_rows(seen, truth))
    wrong, other = np.isin(np.arange(len(seen)), ghosts), np.isin(np.arange(len(truth)), missed)
    add(axis, truth[~other], facecolors=TRUTH, edgecolors=style.GREY, lw=0.5)
    add(axis, truth[other], facecolors=MISSED, edgecolors=style.BLACK, lw=0.7)
    add(axis, seen[~wrong], facecolors="none", edgecolors=FOUND, lw=1.3)
    add(axis, seen[wrong], facecolors="none", edgecolors=GHOST, lw=0.9)
    for a, b, c, d in corners(seen[wrong]):
        for one, opposite in ((a, c), (b, d)):
            axis.plot(*np.stack([one, opposite], axis=1), color=GHOST, lw=0.6)
    for number, (x, y) in enumerate(panel["places"]):
        if number in panel["attackers"]:
            axis.plot(x, y, "o", mfc="none", mec=ATTACKER, mew=2.2, ms=10)
        axis.plot(x, y, "o", mfc=style.BLACK if number in panel["fused"] else "white", mec=style.BLACK, ms=5)
    counts = f"{panel['missed']} missed, {panel['ghosts']} ghosts"
    axis.set_title(f"{title}\n{counts}" if title else counts, fontsize=9)
    axis.set(xlim=(-panel["extent"], panel["extent"]), ylim=(-panel["extent"], panel["extent"]), aspect="equal")
    axis.set(xticks=[-20, 0, 20], yticks=[-20, 0, 20])
    axis.grid(False)


def add(axis: Axes, boxes: Float[np.ndarray, "K 5"], **drawn: Any) -> None:
    """Draw boxes."""
    axis.add_collection(PolyCollection(list(corners(boxes)), **drawn))


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
