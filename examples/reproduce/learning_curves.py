"""Learning curves of PPO against one defender, on scenes held back, over several seeds, beside three baselines.

    python examples/reproduce/learning_curves.py --seeds 0 1 2
    python examples/reproduce/learning_curves.py --recipe.defender bayes --configurations guided stealth:action=stealth

A policy is trained for each configuration and seed, and played on the scenes held back at equal intervals, one episode
a scene, the same episodes each time. Its actions are the policy's means there. Baselines play the same episodes:

* untrained: the policies before they learn, the first point of each curve.
* random: each number of each action is drawn anew in every frame, through the configuration's own action map.
* pgd: 15 steps of projected gradient ascent on the loss of the view that fuses everyone, in every frame.

Started again with the same --out, what is finished is not played again, and a killed run goes on. Written there:
curves.json (all numbers), curves.md (the table) and curves.png.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import torch
import tyro
from matplotlib.axes import Axes
from rich.console import Console
from rich.markdown import Markdown

import agents
from agents.learning.rollout import play
from agents.learning.sweep import TrainingRun, plan_sweep, sweep
from agents.learning.training import Recipe, held_back_scenes
from cp_env.evaluation.plan.files import write_atomically
from cp_env.metrics.shares import share_interval
from cp_env.progress import Progress, say
from cp_env.rendering.style import BLACK, BLUE, GREEN, PAGE, PURPLE, VERMILLION, plot_style, save_plot

COLOURS = (BLUE, VERMILLION, GREEN, PURPLE)
"""One for each configuration."""
BASELINES = {"random": ":", "pgd": "--"}
"""Their dashes."""
MEASURES = {"damage": "detection loss (1 − Jaccard)/frame", "excluded": "share of the attackers excluded"}

Baselines = dict[str, dict[str, list[float]]]
"""By name and measure: one value a scene."""


@dataclass(frozen=True)
class Args:
    """Learning curves with baselines."""

    recipe: Recipe = field(
        default_factory=lambda: Recipe(knowledge="gray-box", frames=2_048, every=2, n_scenes=8, n_holdout=6)
    )
    """what all runs share: the defender, the frames, the scenes held back"""
    configurations: Sequence[str] = ("guided",)
    """names, with what differs from the recipe: name:field=value,field=value"""
    seeds: Sequence[int] = (0, 1, 2)
    """of the learners"""
    workers: int = 1
    """runs trained at once, each in a process with one torch thread"""
    out: Path = Path("runs/curves")


def main(args: Args) -> None:
    torch.set_num_threads(1)
    if len(args.configurations) > len(COLOURS):
        raise SystemExit(f"at most {len(COLOURS)} configurations can be told apart in one picture")
    runs = plan_sweep(
        args.recipe,
        defenders=[args.recipe.defender],
        configurations=args.configurations,
        seeds=args.seeds,
        root=args.out,
    )
    found = baselines(args)
    total = sum(run.recipe.n_segments * run.recipe.segment for run in runs)
    say(f"plan: {len(runs)} runs, {total} frames in all, {args.workers} workers")
    with Progress("learning", total, "frame") as progress:
        for frames in sweep(runs, args.workers):
            progress.to(frames)
    text = write(runs, found, args)
    draw(runs, found, args)
    Console().print(Markdown(text))
    Console().print(f"wrote {args.out}/curves.md, curves.json and curves.png", soft_wrap=True)


def baselines(args: Args) -> Baselines:
    """The scripted attacks on the scenes held back, from the disk if they were played before."""
    recipe, path = args.recipe, args.out / "baselines.json"
    bank, conditions = held_back_scenes(recipe)
    asked = {
        **conditions.describe(),
        "defender": recipe.defender,
        "k": recipe.n_attackers,
        "action": recipe.action,
        "detector": bank.detector.digest,
    }
    if path.exists() and (stored := json.loads(path.read_text()))["asked"] == asked:
        return dict(stored["played"])
    played: Baselines = {}
    for name, spec in (("random", f"random:action={recipe.action}"), ("pgd", "pgd")):
        say(f"playing {name} on {recipe.n_holdout} scenes of {recipe.holdout}")
        episodes = play(agents.make(spec), conditions, bank, defender=recipe.defender, k=recipe.n_attackers)
        played[name] = {measure: getattr(episodes, measure).tolist() for measure in MEASURES}
    write_atomically(path, json.dumps({"asked": asked, "played": played}, indent=1) + "\n")
    return played


def values_of(runs: Sequence[TrainingRun], measure: str) -> tuple[np.ndarray, np.ndarray]:
    """Frames learned from (P,), and the measure of every run there (S, P): points that all runs have reached."""
    curves = [run.curve for run in runs]
    points = min(map(len, curves))
    frames = np.array([evaluation["frames"] for evaluation in curves[0][:points]])
    return frames, np.array([[evaluation[measure] for evaluation in curve[:points]] for curve in curves])


def by_configuration(runs: Sequence[TrainingRun]) -> dict[str, list[TrainingRun]]:
    """The runs of each configuration, in the order of the plan."""
    groups: dict[str, list[TrainingRun]] = {}
    for run in runs:
        groups.setdefault(run.configuration, []).append(run)
    return groups


def write(runs: Sequence[TrainingRun], found: Baselines, args: Args) -> str:
    """Write curves.json and curves.md; returns the Markdown: every point's mean over seeds, and their range."""
    groups, recipe = by_configuration(runs), args.recipe
    frames, _ = values_of(runs, "damage")
    lines = [
        f"Against {recipe.defender}, k = {recipe.n_attackers} of {recipe.n_vehicles}: detection loss/frame on "
        f"{recipe.n_holdout} scenes of {recipe.holdout}, {recipe.max_frames} frames each; mean and range over "
        f"{len(args.seeds)} seeds.\n",
        f"| attack | {' | '.join(f'{int(count)} frames' for count in frames)} |",
        f"|---|{'---|' * len(frames)}",
    ]
    for name, group in groups.items():
        _, values = values_of(group, "damage")
        points = [f"{of.mean():.3f} ({of.min():.3f} to {of.max():.3f})" for of in values.T[: len(frames)]]
        lines.append(f"| {name} | {' | '.join(points)} |")
    lines += [
        "",
        "Baselines, with Gaffke's 95 % interval over scenes:\n",
        "| attack | detection loss/frame |",
        "|---|---|",
    ]
    lines += [f"| {name} | {format(share_interval(of['damage']), '.3f')} |" for name, of in found.items()]
    text = "\n".join(lines) + "\n"
    data: dict[str, Any] = {
        "recipe": asdict(recipe),
        "baselines": found,
        "curves": [{"configuration": run.configuration, "seed": run.recipe.seed, "curve": run.curve} for run in runs],
    }
    write_atomically(args.out / "curves.json", json.dumps(data, indent=1) + "\n")
    write_atomically(args.out / "curves.md", text)
    return text


@plot_style()
def draw(runs: Sequence[TrainingRun], found: Baselines, args: Args) -> None:
    """Draw curves.png: a panel for each measure; mean over seeds as a line, their range as a band."""
    recipe = args.recipe
    figure, panels = plt.subplots(1, len(MEASURES), figsize=(PAGE, 3.5), sharex=True)
    for axes, (measure, label) in zip(panels, MEASURES.items(), strict=True):
        for colour, (name, group) in zip(COLOURS, by_configuration(runs).items(), strict=False):
            _curve(axes, name, *values_of(group, measure), colour)
        for name, dashes in BASELINES.items():
            axes.axhline(float(np.mean(found[name][measure])), color=BLACK, ls=dashes, lw=1.2, label=name)
        axes.set(xlabel="frames learned from", ylabel=label, ylim=(0, 1), xlim=(0, None))
    handles, labels = panels[0].get_legend_handles_labels()
    title = (
        f"{recipe.defender}, k = {recipe.n_attackers} of {recipe.n_vehicles}, {recipe.n_holdout} scenes held back; "
        f"mean and range over {len(args.seeds)} seeds"
    )
    figure.legend(
        handles, labels, loc="upper center", ncols=4 if len(labels) <= 4 else 3, title=title, alignment="left"
    )
    figure.tight_layout(rect=(0, 0, 1, 0.86 if len(labels) <= 4 else 0.8))
    save_plot(figure, args.out / "curves.png")
    plt.close(figure)


def _curve(axes: Axes, name: str, frames: np.ndarray, values: np.ndarray, colour: str) -> None:
    axes.plot(frames, values.mean(0), "o-", ms=3.5, color=colour, label=f"PPO, {name}")
    axes.fill_between(frames, values.min(0), values.max(0), color=colour, alpha=0.2, lw=0)
    axes.axhline(values[:, 0].mean(), color=colour, ls="-.", lw=1.0, label=f"untrained, {name}")


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
