"""Tables 3, 6 and 7 of the paper: AP of a defended ego, ours and the paper's; n = 5, k = 2.

    python examples/reproduce/defence_tables.py --table 3       # every defence and fusion, PGD, BIM and C&W
    python examples/reproduce/defence_tables.py --table 6       # attacks in every, every third and every fifth frame
    python examples/reproduce/defence_tables.py --table 7       # thresholds ε of PRBI
    python examples/reproduce/defence_tables.py --table loss    # our objective beside the standard detection loss

Upper bound: everyone fused and benign; lower bound: the ego alone. As in the paper, five vehicles and a road-side unit
share their maps: six in all, which every defender judges alike; `--no-rsu` leaves the unit out. The attacks are those
of Sec. 11.1: Δ = 0.3, 15 steps of 0.1, PGD from a random start, BIM and C&W from zero, both attackers jointly. The
attackers are drawn anew for every scene among the vehicles, the ego too, as in the paper's threat model; the first
frame is benign. AP counts every vehicle in range, seen or hidden, in all frames, also in those before a defender has
converged. ROBOSAC is given k and draws teams of n - k until one passes, which is the reading that gives the paper's
Table 2. PASAC has thresholds calibrated for each fusion: its published one was made for segmentation and lets nearly
every perturbation pass. PRBI is as published, and with calibrated thresholds.

Several tables named at once share what they have in common. What is played is kept in `out`: the same command goes on
where a killed run stopped, and with more of `--n-scenes` it adds to it. An attack that knows of no defence is computed
once for all defenders. The paper's figures are for V2X-Sim, 100 frames of 5 scenes, and detectors of its own: what can
be compared is how they fall and in what order.
"""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import torch
import tyro
from rich.console import Console
from rich.progress import Progress

sys.path.insert(0, str(Path(__file__).parents[2]))  # figures and the paper's tables are other examples

import agents
from agents.attacks.cached import CachedAttack
from cp_env import evaluation
from cp_env.rendering import style
from cp_env.scenes import open_source
from cp_env.settings import Fusion, Precision
from examples.reproduce.defence_figures import (
    TITLES,
    Found,
    Records,
    by_ego,
    fig_6,
    figures,
    headline,
    markdown,
    objectives,
    shown,
)
from examples.reproduce.paper_tables import FUSIONS, TABLES, PaperTable

N_ATTACKERS = 2
COLOURS = (style.BLUE, style.ORANGE)  # of a panel's one or two figures
PANELS = 3  # side by side
SHORT = {
    "id_rate": "attackers identified",
    "mc_rate": "benign misclassified",
    "mc_runs": "runs with one misclassified",
    "frames_to_convergence": "until convergence",
}
"""Titles of panels."""


@dataclass(frozen=True)
class Args:
    """Defences on test scenes, with the paper's figures."""

    table: tuple[str, ...] = ("3",)  # one or more of 3, 6, 7 and loss
    scenes: str = "town/test"
    n_scenes: int = 6  # the first of the source's list, in which its kinds take turns
    frames: int = 20  # of each, from one drawn by the seed
    fusions: tuple[Fusion, ...] | None = None  # by default each table's
    rsu: bool = True  # whether the road-side unit shares its map
    precision: Precision = "float32"  # of the detector's maps, fusion and decoder
    batch: int = 3  # scenes in lock-step
    seed: int = 0
    workers: int = 1  # processes
    threads: int = 1  # torch threads of each
    out: Path = Path("out/defence_tables")

    def __post_init__(self) -> None:
        if unknown := [name for name in self.table if name not in TABLES]:
            raise ValueError(f"no table {unknown[0]!r}: choose among {', '.join(TABLES)}")

    def of(self, table: PaperTable) -> tuple[Fusion, ...]:
        """The fusions that a table is played with."""
        return tuple(f for f in table.fusions if self.fusions is None or f in self.fusions)


@lru_cache(maxsize=8)
def make_attack(name: str, **options: Any) -> evaluation.Attack:
    """The attack of that name, which all runs of a process share."""
    return CachedAttack(agents.make(name, **options))


def measure(args: Args) -> dict[Fusion, Records]:
    """Play what is not there yet; the episodes of every fusion."""
    chosen = tuple(open_source(args.scenes).names()[: args.n_scenes])
    workers = evaluation.Workers(make_attack=make_attack, processes=args.workers, threads=args.threads)
    tables = [TABLES[name] for name in args.table]
    results: dict[Fusion, Records] = {}
    with Progress(console=Console(stderr=True)) as progress:
        for fusion in (f for f in FUSIONS if any(f in args.of(table) for table in tables)):
            conditions = evaluation.Conditions(
                args.scenes, chosen, args.frames, rsu=args.rsu, fusion=fusion, precision=args.precision
            )
            runs = plan(conditions, [table for table in tables if fusion in args.of(table)], args)
            store = evaluation.Store(args.out, evaluation.open_bank(conditions).detector.digest)
            bar = progress.add_task(fusion, total=len(chosen) + len(runs))
            for _ in evaluation.prepare(runs, conditions, workers):
                progress.advance(bar)
            for _ in evaluation.execute(runs, conditions, store, workers):
                progress.advance(bar)
            results[fusion] = store.load(runs, conditions)
    return results


def plan(conditions: evaluation.Conditions, tables: Iterable[PaperTable], args: Args) -> list[evaluation.Run]:
    """Every run once; those that play the same attack on the same scenes follow each other."""
    runs = {
        run: None
        for table in tables
        for line in table.lines
        for run in evaluation.plan_runs(
            conditions,
            defenders=(line.defender,),
            attacks=line.attacks,
            ks=(N_ATTACKERS,),
            seeds=(args.seed,),
            batch=args.batch,
        )
    }
    return sorted(runs, key=lambda run: (conditions.names.index(run.names[0]), run.attack))


@style.plot_style()
def draw(found: Found, table: PaperTable, fusions: tuple[Fusion, ...], path: Path) -> Path:
    """A panel a fusion for AP, and one for each further figure; dots with intervals: ours, diamonds: the paper's."""
    aps, others = table.figures[:2], table.figures[2:]
    panels = [(fusion, group) for fusion in fusions for group in (aps, *((name,) for name in others))]
    columns = min(len(panels), PANELS)
    rows = -(-len(panels) // columns)
    size = style.PAGE, rows * (0.9 + 0.26 * len(table.lines)) + 0.7
    figure, axes = plt.subplots(rows, columns, figsize=size, sharey=True, squeeze=False, layout="constrained")
    for axis in axes.flat[len(panels) :]:
        axis.set_visible(False)
    for axis, (fusion, group) in zip(axes.flat, panels, strict=False):
        for number, (name, colour) in enumerate(zip(group, COLOURS, strict=False)):
            for row, line in enumerate(table.lines):
                place = row + 0.14 * (2 * number - len(group) + 1)
                ours, theirs = shown(name, found[fusion, line.label][name]), line.paper.get(name)
                if ours is not None:
                    axis.plot(ours[1:], (place, place), color=colour, lw=1.5)
                    axis.plot(ours[0], place, "o", color=colour, ms=4)
                if theirs is not None:
                    axis.plot(theirs[table.fusions.index(fusion)], place, "D", mfc="none", mec=colour, ms=5)
        axis.set_title(fusion if len(group) > 1 else f"{fusion}:\n{SHORT[group[0]]}")
        axis.set_xlabel("AP (%)" if len(group) > 1 else "frames" if group == ("frames_to_convergence",) else "%")
        axis.set_xlim((-3, 103) if group != ("frames_to_convergence",) else (0, None))
        axis.grid(axis="x", color=style.GRID)
    for name, colour in zip(aps, COLOURS, strict=False):
        axes[0, 0].plot([], [], "o-", color=colour, label=f"ours, {TITLES[name].removesuffix(' in %')}")
        if any(line.paper for line in table.lines):
            axes[0, 0].plot([], [], "D", mfc="none", mec=colour, label=f"paper, {TITLES[name].removesuffix(' in %')}")
    axes[0, 0].set_yticks(range(len(table.lines)), [line.label for line in table.lines])
    axes[0, 0].invert_yaxis()
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    style.save_plot(figure, path)
    plt.close(figure)
    return path


def report(name: str, results: dict[Fusion, Records], args: Args) -> None:
    """Print a table, and write it as JSON and as a picture."""
    table, fusions = TABLES[name], args.of(TABLES[name])
    mine = {fusion: results[fusion] for fusion in fusions}
    found: Found = {(f, line.label): figures(line, mine[f]) for f in fusions for line in table.lines}
    print(*markdown(found, table, fusions), sep="\n")
    if name == "3":
        attacked = [line for line in table.lines if "none" not in line.attacks and len(line.attacks) > 1]
        print(
            *headline(mine),
            *headline(mine, "prbi:threshold=calibrated"),
            *by_ego(mine, attacked),
            *fig_6(mine),
            sep="\n",
        )
    if name == "loss":
        for fusion in fusions:
            print(*objectives(mine[fusion]), sep="\n")
    rows = [
        {
            "fusion": f,
            **asdict(line),
            "ours": {key: value and asdict(value) for key, value in found[f, line.label].items()},
        }
        for f in fusions
        for line in table.lines
    ]
    about = {"command": shlex.join(["python", *sys.argv]), **json.loads(json.dumps(asdict(args), default=str))}
    path = args.out / f"table_{name}.json"
    path.write_text(json.dumps({"about": about, "rows": rows}, indent=1) + "\n")
    print("written:", path, draw(found, table, fusions, path.with_suffix(".png")))


def main(args: Args) -> None:
    torch.set_num_threads(args.threads)
    results = measure(args)
    for name in args.table:
        report(name, results, args)


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
