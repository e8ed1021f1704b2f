"""Table 3 of the paper without its defences: what five fusions see, alone, together and under attack, at k = 2 of 5.

    python examples/reproduce/fusion_table.py                                         # a few minutes
    python examples/reproduce/fusion_table.py --n-scenes 6 --frames 20 --workers 2    # the published figures

Upper bound: everyone fused and honest; lower bound: the ego alone. The attacks are those of Sec. 11.1: Δ = 0.3, 15
steps of 0.1, PGD from a random start, BIM and C&W from zero; two vehicles of five, drawn anew for every scene, lie in
every frame but the first. AP counts every vehicle in range, seen or hidden; 95 % intervals are bootstrapped over
scenes. What is played is kept in `out`: the same command goes on where a killed run stopped, and a longer one adds to
it. The paper's figures are for V2X-Sim and detectors of its own: what can be compared is how they fall and in what
order, not their height.
"""

from __future__ import annotations

import json
import shlex
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import torch
import tyro
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

import agents
from cp_env import evaluation
from cp_env.scenes import open_source

FUSIONS = ("mean", "max", "sum", "v2vnet", "disconet")
PAPER = {  # AP@0.5 and AP@0.7 of each fusion, per cent
    "upper": ((79.57, 75.34), (78.62, 75.07), (77.88, 74.38), (80.73, 78.35), (80.52, 76.72)),
    "pgd": ((16.51, 14.60), (27.16, 26.45), (13.65, 7.31), (17.02, 14.53), (20.97, 19.54)),
    "bim": ((13.67, 9.08), (33.54, 32.71), (4.56, 4.13), (13.51, 11.69), (21.02, 18.53)),
    "cw": ((7.51, 3.42), (25.99, 24.88), (8.52, 7.12), (10.68, 6.04), (14.90, 10.93)),
    "lower": ((56.35, 52.89),) * 5,
}
LABELS = {"upper": "upper bound", "pgd": "PGD", "bim": "BIM", "cw": "C&W", "lower": "lower bound (ego alone)"}
LIARS = 2

Figures = dict[str, dict[str, evaluation.Row]]  # by row of the table, then by fusion


@dataclass(frozen=True)
class Args:
    """Five fusions, alone, together and under attack."""

    scenes: str = "town/test"
    n_scenes: int = 3  # spread evenly over the source's list
    frames: int = 10  # of each, from one drawn by the seed
    fusions: tuple[str, ...] = FUSIONS
    seed: int = 0
    batch: int = 3  # scenes in lock-step
    workers: int = 1  # processes
    threads: int = 1  # torch threads of each
    out: Path = Path("out/fusion_table")


def measure(args: Args) -> Figures:
    """Play what is not there yet; the rows of every fusion."""
    names = open_source(args.scenes).names()
    chosen = tuple(names[i * len(names) // args.n_scenes] for i in range(args.n_scenes))
    figures: Figures = {row: {} for row in PAPER}
    with Progress(console=Console(stderr=True)) as progress:
        for fusion in args.fusions:
            protocol = evaluation.Protocol(args.scenes, chosen, args.frames, fusion=fusion)
            cells = plan(protocol, args)
            store = evaluation.Store(args.out, evaluation.open_bank(protocol).detector.digest)
            crew = evaluation.Crew(make_attacker=agents.make, workers=args.workers, threads=args.threads)
            bar = progress.add_task(fusion, total=len(chosen) + len(cells))
            for _ in evaluation.prepare(cells, protocol, crew):
                progress.advance(bar)
            for _ in evaluation.run(cells, protocol, store, crew):
                progress.advance(bar)
            for row in evaluation.summarise(store.load(cells, protocol)):
                figures[name_of(row)][fusion] = row
    return figures


def plan(protocol: evaluation.Protocol, args: Args) -> list[evaluation.Cell]:
    """The cells of both bounds and of the attacks."""
    everyone, alone = (
        evaluation.plan(
            protocol, defenders=(defender,), attacks=attacks, ks=(LIARS,), seeds=(args.seed,), batch=args.batch
        )
        for defender, attacks in (("none", ("none", "pgd", "bim", "cw")), ("ego_only", ("none",)))
    )
    return everyone + alone


def name_of(row: evaluation.Row) -> str:
    """Which row of Table 3 it is."""
    if row.attack != "none":
        return row.attack
    return "upper" if row.defender == "none" else "lower"


def screen(figures: Figures) -> list[Table]:
    """Ours with intervals, the paper's behind a stroke; per cent, one table an IoU."""
    tables = []
    for column, (figure, iou) in enumerate((("ap50", 0.5), ("ap70", 0.7))):
        fusions = list(figures["upper"])
        table = Table("", *fusions, title=f"AP@{iou} in %: ours [95 % interval] | paper's", box=None, pad_edge=False)
        for row, by_fusion in figures.items():
            cells = []
            for fusion in fusions:
                ap, theirs = getattr(by_fusion[fusion], figure), PAPER[row][FUSIONS.index(fusion)][column]
                cells.append(f"{100 * ap.mean:.1f} [{100 * ap.low:.0f}, {100 * ap.high:.0f}] | {theirs:.1f}")
            table.add_row(LABELS[row], *cells)
        tables.append(table)
    return tables


def draw(figures: Figures, path: Path) -> Path:
    """Bars: ours, with intervals; diamonds: the paper's."""
    fusions = list(figures["upper"])
    figure, axes = plt.subplots(2, 1, figsize=(10, 7), sharex=True, layout="constrained")
    colours = plt.get_cmap("viridis")(np.linspace(0.05, 0.9, len(PAPER)))
    width = 0.8 / len(PAPER)
    for column, (axis, key, iou) in enumerate(zip(axes, ("ap50", "ap70"), (0.5, 0.7), strict=True)):
        for number, (row, by_fusion) in enumerate(figures.items()):
            place = np.arange(len(fusions)) + (number - (len(PAPER) - 1) / 2) * width
            ap = [getattr(by_fusion[fusion], key) for fusion in fusions]
            mean = 100 * np.array([a.mean for a in ap])
            reach = 100 * np.array([[a.mean - a.low for a in ap], [a.high - a.mean for a in ap]]).clip(0)
            axis.bar(place, mean, width, yerr=reach, capsize=2, color=colours[number], label=LABELS[row])
            theirs = [PAPER[row][FUSIONS.index(fusion)][column] for fusion in fusions]
            label = "paper (V2X-Sim)" if number == len(PAPER) - 1 else None
            axis.plot(place, theirs, "D", ms=5, mfc="white", mec="black", label=label, ls="none")
        axis.set(ylabel=f"AP@{iou} (%)", ylim=(0, 100), xticks=range(len(fusions)), xticklabels=fusions)
    axes[1].set_xlabel("fusion")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3, frameon=False)
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return path


def main(args: Args) -> None:
    torch.set_num_threads(args.threads)
    figures = measure(args)
    console = Console(width=150)
    console.print(*screen(figures), sep="\n", highlight=False)
    rows = {row: {fusion: asdict(figure) for fusion, figure in by.items()} for row, by in figures.items()}
    about = {"command": shlex.join(["python", *sys.argv]), **json.loads(json.dumps(asdict(args), default=str))}
    (args.out / "fusion_table.json").write_text(
        json.dumps({"about": about, "rows": rows, "paper": PAPER}, indent=1) + "\n"
    )
    console.print("written:", args.out / "fusion_table.json", draw(figures, args.out / "fusion_table.png"))


if __name__ == "__main__":
    main(tyro.cli(Args))
