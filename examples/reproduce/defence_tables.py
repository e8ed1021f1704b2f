"""Tables 3, 6 and 7 of the paper: AP of a defended ego, ours and the paper's; n = 5, k = 2.

    python examples/reproduce/defence_tables.py --table 3       # every defence and fusion, PGD, BIM and C&W
    python examples/reproduce/defence_tables.py --table 6       # attacks in every, every third and every fifth frame
    python examples/reproduce/defence_tables.py --table 7       # thresholds ε of PRBI

Upper bound: everyone fused and benign; lower bound: the ego alone. The attacks are those of Sec. 11.1: Δ = 0.3, 15
steps of 0.1, PGD from a random start, BIM and C&W from zero, both attackers jointly. The attackers are drawn anew for
every scene, the ego among those who may be drawn, as in the paper's threat model; the first frame is benign. AP counts
every vehicle in range, seen or hidden, in all frames, also in those before a defender has converged; 95 % intervals are
over scenes, Gaffke's for AP, Student's t for frames. ROBOSAC is given k and draws teams of n - k until one passes,
which is the reading that gives the paper's Table 2. PASAC has thresholds calibrated for each fusion: its published one
was made for segmentation and lets nearly every perturbation pass. PRBI is as published, and with calibrated thresholds.

What is played is kept in `out`: the same command goes on where a killed run stopped, and with a multiple of
`--n-scenes` it adds to it. An attack that knows of no defence is computed once for all defenders. The paper's figures
are for V2X-Sim, 100 frames of 5 scenes, and detectors of its own: what can be compared is how they fall and in what
order.
"""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import torch
import tyro
from rich.console import Console
from rich.progress import Progress

import agents
from agents.attacks.cached import CachedAttack
from cp_env import evaluation
from cp_env.metrics.intervals import Interval
from cp_env.scenes import open_source
from cp_env.settings import Fusion, Precision
from examples.reproduce.paper_tables import TABLES, Line, PaperTable

N_ATTACKERS = 2
TITLES = {
    "ap50": "AP@0.5 in %",
    "ap70": "AP@0.7 in %",
    "id_rate": "attackers identified, %",
    "mc_rate": "benign misclassified, %",
    "frames_to_convergence": "frames to convergence",
}
COLOURS = ("tab:blue", "tab:orange")  # of a panel's one or two figures

Figures = dict[str, Interval | None]  # by name
Found = dict[tuple[str, str], Figures]  # by fusion and label


@dataclass(frozen=True)
class Args:
    """Defences on test scenes, with the paper's figures."""

    table: int = 3  # or 6, 7
    scenes: str = "town/test"
    n_scenes: int = 6  # spread evenly over the source's list, so over its three kinds
    frames: int = 20  # of each, from one drawn by the seed
    fusions: tuple[Fusion, ...] | None = None  # by default the table's
    precision: Precision = "float32"  # of the detector's maps, fusion and decoder
    seed: int = 0
    workers: int = 1  # processes
    threads: int = 1  # torch threads of each
    out: Path = Path("out/defence_tables")


@lru_cache(maxsize=8)
def make_attack(name: str, **options: Any) -> evaluation.Attack:
    """The attack of that name, which all runs of a process share."""
    return CachedAttack(agents.make(name, **options))


def measure(args: Args, table: PaperTable) -> Found:
    """Play what is not there yet; the figures of every fusion and line."""
    names = open_source(args.scenes).names()
    chosen = tuple(names[i * len(names) // args.n_scenes] for i in range(args.n_scenes))
    workers = evaluation.Workers(make_attack=make_attack, processes=args.workers, threads=args.threads)
    found: Found = {}
    with Progress(console=Console(stderr=True)) as progress:
        for fusion in args.fusions or table.fusions:
            conditions = evaluation.Conditions(
                args.scenes, chosen, args.frames, fusion=fusion, precision=args.precision
            )
            runs = plan(conditions, table, args)
            store = evaluation.Store(args.out, evaluation.open_bank(conditions).detector.digest)
            bar = progress.add_task(fusion, total=len(chosen) + len(runs))
            for _ in evaluation.prepare(runs, conditions, workers):
                progress.advance(bar)
            for _ in evaluation.execute(runs, conditions, store, workers):
                progress.advance(bar)
            results = store.load(runs, conditions)
            found |= {(fusion, line.label): figures(line, results) for line in table.lines}
    return found


def plan(conditions: evaluation.Conditions, table: PaperTable, args: Args) -> list[evaluation.Run]:
    """Every run once, a scene each; those that play the same attack on the same scene follow each other."""
    runs = {
        run: None
        for line in table.lines
        for run in evaluation.plan_runs(
            conditions, defenders=(line.defender,), attacks=line.attacks, ks=(N_ATTACKERS,), seeds=(args.seed,), batch=1
        )
    }
    return sorted(runs, key=lambda run: (run.names, run.attack))


def figures(line: Line, results: dict[evaluation.Run, tuple[evaluation.Record, ...]]) -> Figures:
    """AP averaged over the line's attacks; the other figures over the episodes of all of them."""
    mine = {run: records for run, records in results.items() if run.defender == line.defender}
    groups = [[r for run, of in mine.items() if run.attack == attack for r in of] for attack in line.attacks]
    as_one: dict[evaluation.Run, list[evaluation.Record]] = {}
    for run, of in mine.items():
        if run.attack in line.attacks:
            as_one.setdefault(replace(run, attack="all"), []).extend(of)
    (row,) = evaluation.summarise(as_one, resamples=1)  # its own AP is not used
    others = {name: getattr(row, name) for name in TITLES if not name.startswith("ap")}
    return {"ap50": evaluation.mean_ap(groups, 0.5), "ap70": evaluation.mean_ap(groups, 0.7), **others}


def shown(figure: str, interval: Interval | None) -> tuple[float, float, float] | None:
    """Mean and bounds in the unit of the title."""
    if interval is None:
        return None
    scale = 1.0 if figure == "frames_to_convergence" else 100.0
    return scale * interval.mean, scale * interval.low, scale * interval.high


def markdown(found: Found, table: PaperTable, fusions: tuple[str, ...]) -> Iterator[str]:
    """A table a figure: ours [95 % interval], and the paper's behind a stroke."""
    for figure in table.figures:
        yield f"\n| {TITLES[figure]} | " + " | ".join(fusions) + " |\n|---|" + "---|" * len(fusions)
        for line in table.lines:
            cells = []
            for fusion in fusions:
                ours = shown(figure, found[fusion, line.label][figure])
                text = "–" if ours is None else "{:.1f} [{:.1f}, {:.1f}]".format(*ours)
                theirs = line.paper.get(figure)
                cells.append(text if theirs is None else f"{text} \\| {theirs[table.fusions.index(fusion)]:.1f}")
            yield f"| {line.label} | " + " | ".join(cells) + " |"


def draw(found: Found, table: PaperTable, fusions: tuple[str, ...], path: Path) -> Path:
    """A panel a fusion for AP, and one for each further figure; dots with intervals: ours, diamonds: the paper's."""
    aps, others = table.figures[:2], table.figures[2:]
    panels = [(fusion, group) for fusion in fusions for group in (aps, *((name,) for name in others))]
    figure, axes = plt.subplots(
        1,
        len(panels),
        figsize=(2.2 + 2.3 * len(panels), 1.6 + 0.34 * len(table.lines)),
        sharey=True,
        squeeze=False,
        layout="constrained",
    )
    for axis, (fusion, group) in zip(axes[0], panels, strict=True):
        for number, (name, colour) in enumerate(zip(group, COLOURS, strict=False)):
            for row, line in enumerate(table.lines):
                place = row + 0.14 * (2 * number - len(group) + 1)
                ours, theirs = shown(name, found[fusion, line.label][name]), line.paper.get(name)
                if ours is not None:
                    axis.plot(ours[1:], (place, place), color=colour, lw=1.5)
                    axis.plot(ours[0], place, "o", color=colour, ms=5)
                if theirs is not None:
                    axis.plot(theirs[table.fusions.index(fusion)], place, "D", mfc="none", mec=colour, ms=6)
            axis.plot([], [], "o-", color=colour, label=f"ours, {TITLES[name]}")
            axis.plot([], [], "D", mfc="none", mec=colour, label=f"paper (V2X-Sim), {TITLES[name]}")
        axis.set_title(fusion if len(group) > 1 else f"{fusion}: {TITLES[group[0]]}", fontsize=10)
        axis.set_xlabel("AP (%)" if len(group) > 1 else TITLES[group[0]])
        axis.set_xlim((-3, 103) if group != ("frames_to_convergence",) else (0, None))
        axis.grid(axis="x", color="0.9")
    axes[0, 0].set_yticks(range(len(table.lines)), [line.label for line in table.lines])
    axes[0, 0].invert_yaxis()
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside upper center", ncols=4 if len(panels) > 2 else 2, frameon=False, fontsize=9
    )
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return path


def main(args: Args) -> None:
    torch.set_num_threads(args.threads)
    table = TABLES[args.table]
    fusions = args.fusions or table.fusions
    found = measure(args, table)
    print(*markdown(found, table, fusions), sep="\n")
    rows = [
        {"fusion": fusion, **asdict(line), "ours": {name: value and asdict(value) for name, value in ours.items()}}
        for (fusion, label), ours in found.items()
        for line in table.lines
        if line.label == label
    ]
    about = {"command": shlex.join(["python", *sys.argv]), **json.loads(json.dumps(asdict(args), default=str))}
    name = f"table_{args.table}"
    (args.out / f"{name}.json").write_text(json.dumps({"about": about, "rows": rows}, indent=1) + "\n")
    print("written:", args.out / f"{name}.json", draw(found, table, fusions, args.out / f"{name}.png"))


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
