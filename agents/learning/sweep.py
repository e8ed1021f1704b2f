"""Sweeps of training runs: configurations × seeds against each defender, of which the strongest policies are kept.

A learned attack says something about a defence only when it is the strongest of several seeds and configurations
(as the literature on robust reinforcement learning does). The strongest is chosen on scenes held back from training,
and reported on others.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, wait
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import torch

from agents.learning.callbacks import Evaluation, read_curve
from agents.learning.rollout import slug
from agents.learning.training import Recipe, train
from cp_env.metrics.shares import share_interval
from cp_env.process import WorkerContext, end_with_parent
from cp_env.world.allocator import keep_freed_memory
from defenders.registry import Spec, typed_options

POLL = 2.0
"""Seconds between two reports of progress."""


@dataclass(frozen=True)
class TrainingRun:
    """One training run of a sweep: it lives in a folder of its own."""

    configuration: str  # its name
    recipe: Recipe
    root: Path  # of the sweep

    @property
    def folder(self) -> Path:
        return self.root / slug(self.recipe.defender) / f"{self.configuration}-{self.recipe.seed}"

    @property
    def curve(self) -> list[Evaluation]:
        return read_curve(self.folder)

    @property
    def best(self) -> Evaluation:
        """The evaluation of the policy that the run has kept."""
        return max(self.curve, key=lambda evaluation: evaluation[self.recipe.measure])


def plan_sweep(
    base: Recipe, *, defenders: Sequence[str], configurations: Sequence[str], seeds: Sequence[int], root: Path
) -> list[TrainingRun]:
    """Every training run, seeds outermost: a sweep cut short has tried everything once.

    Args:
        base: what all runs share.
        defenders: names, with options if need be.
        configurations: names, or names with fields of `Recipe` that differ from `base`: `joint:joint=True,gamma=0.95`.
        seeds: of the runs.
        root: folder of the sweep.

    Returns:
        The runs.

    Raises:
        ValueError: a configuration that names no field, or an axis that is empty or holds something twice.
    """
    named = [Spec.parse(configuration) for configuration in configurations]
    for what, values in (
        ("defenders", [slug(d) for d in defenders]),
        ("configurations", [spec.name for spec in named]),
        ("seeds", seeds),
    ):
        if not values or len(set(values)) != len(values):
            raise ValueError(f"{what} must be distinct, and at least one; got {list(values)}")
    differing = [
        typed_options(Recipe, spec.options, f"configuration {spec.name!r}", given=("defender", "seed"))
        for spec in named
    ]
    return [
        TrainingRun(spec.name, replace(base, defender=defender, seed=seed, **options), root)
        for seed, defender, (spec, options) in product(seeds, defenders, zip(named, differing, strict=True))
    ]


def sweep(runs: Sequence[TrainingRun], workers: int) -> Iterator[int]:
    """Train all runs; yields the number of frames learned from, now and then.

    A run that is finished is not trained again, one that was killed goes on.

    Args:
        runs: the training runs.
        workers: runs trained at once, each in a process with one torch thread.
    """
    if workers == 1:
        for run in runs:
            _train(run)
            yield _learned(runs)
        return
    with ProcessPoolExecutor(workers, mp_context=WorkerContext(), initializer=_begin_worker) as pool:
        futures: set[Future[None]] = {pool.submit(_train, run) for run in runs}
        try:
            while futures:
                done, futures = wait(futures, POLL)
                for future in done:
                    future.result()
                yield _learned(runs)
        finally:  # an error, or a caller that stops asking: start nothing new
            pool.shutdown(wait=False, cancel_futures=True)


def _begin_worker() -> None:
    """One torch thread; and a worker ends with whoever started it, also if that is killed."""
    end_with_parent()
    torch.set_num_threads(1)
    keep_freed_memory()


def _train(run: TrainingRun) -> None:
    train(run.recipe, run.folder)


def _learned(runs: Sequence[TrainingRun]) -> int:
    return sum(int(run.curve[-1]["frames"]) for run in runs if run.curve)


def strongest(runs: Sequence[TrainingRun]) -> dict[str, TrainingRun]:
    """Of each defender, the run whose policy did most damage on the scenes held back."""
    best: dict[str, TrainingRun] = {}
    for run in sorted(runs, key=lambda run: run.best["damage"]):
        best[run.recipe.defender] = run
    return best


def keep(runs: Sequence[TrainingRun], folder: Path) -> list[Path]:
    """Copy the strongest policy against each defender into `folder`, under the defender's name."""
    folder.mkdir(parents=True, exist_ok=True)
    return [
        Path(shutil.copy(run.folder / "policy.safetensors", folder / f"{slug(defender)}.safetensors"))
        for defender, run in strongest(runs).items()
    ]


@dataclass(frozen=True)
class Line:
    """What one configuration reached against one defender on the scenes held back."""

    defender: str
    configuration: str
    seeds: tuple[int, ...]
    damage: tuple[float, ...]  # per frame, of each seed's best policy
    excluded: tuple[float, ...]  # share of the attackers that this policy had left out
    strongest: bool  # it holds the policy that is kept

    def row(self) -> str:
        damage, excluded = share_interval(list(self.damage)), share_interval(list(self.excluded))
        name = f"{self.configuration}{' (kept)' if self.strongest else ''}"
        values = f"{format(damage, '.3f')} | {max(self.damage):.3f} | {format(excluded, '.2f')}"
        return f"| {self.defender} | {name} | {len(self.seeds)} | {values} |"


def summarise(runs: Sequence[TrainingRun]) -> list[Line]:
    """One line for each configuration and defender, in the order of the plan."""
    kept = {run.folder for run in strongest(runs).values()}
    groups: dict[tuple[str, str], list[TrainingRun]] = {}
    for run in runs:
        groups.setdefault((run.recipe.defender, run.configuration), []).append(run)
    return [
        Line(
            defender=defender,
            configuration=configuration,
            seeds=tuple(run.recipe.seed for run in group),
            damage=tuple(run.best["damage"] for run in group),
            excluded=tuple(run.best["excluded"] for run in group),
            strongest=any(run.folder in kept for run in group),
        )
        for (defender, configuration), group in groups.items()
    ]


def write_table(lines: Sequence[Line], root: Path, conditions: dict[str, Any]) -> str:
    """Write `sweep.json` and `sweep.md` in `root`; returns the Markdown."""
    head = [
        "| defender | configuration | seeds | detection loss/frame | highest | attackers excluded |",
        "|---|---|--:|---|--:|---|",
    ]
    text = "\n".join([*head, *(line.row() for line in lines)]) + "\n"
    (root / "sweep.md").write_text(text)
    (root / "sweep.json").write_text(
        json.dumps({"conditions": conditions, "lines": [asdict(line) for line in lines]}, indent=1)
    )
    return text
