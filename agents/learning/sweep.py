"""Many attackers trained: configurations × seeds against each defender, and the strongest kept.

A learned attacker says something about a defence only when it is the strongest of several seeds and configurations
(as the literature on robust reinforcement learning does); which one is strongest is decided on scenes held back from
training, and told on others.
"""

from __future__ import annotations

import json
import multiprocessing
import shutil
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, wait
from dataclasses import asdict, dataclass, fields, replace
from itertools import product
from pathlib import Path
from typing import Any

import torch

from agents.learning.callbacks import Look, read_curve
from agents.learning.training import Recipe, train
from cp_env.evaluation import parse
from cp_env.metrics.intervals import t_interval

POLL = 2.0
"""Seconds between two looks at how far the runs are."""


@dataclass(frozen=True)
class Run:
    """One training run of a sweep: it lives in a folder of its own."""

    configuration: str  # its name
    recipe: Recipe
    root: Path  # of the sweep

    @property
    def folder(self) -> Path:
        return self.root / slug(self.recipe.defender) / f"{self.configuration}-{self.recipe.seed}"

    @property
    def curve(self) -> list[Look]:
        return read_curve(self.folder)

    @property
    def best(self) -> Look:
        """The look at which most damage was done."""
        return max(self.curve, key=lambda look: look["damage"])


def slug(defender: str) -> str:
    """A name fit for files: `pasac:score=similarity` is `pasac-similarity`."""
    name, knobs = parse(defender)
    return "-".join([name, *map(str, knobs.values())])


def plan_sweep(
    base: Recipe, *, defenders: Sequence[str], configurations: Sequence[str], seeds: Sequence[int], root: Path
) -> list[Run]:
    """Every run, seeds outermost: a sweep cut short has tried everything once.

    A configuration is a name, or a name with fields of `Recipe` that differ from `base`: `joint:joint=True,gamma=0.95`.

    Raises ValueError for a configuration that names no field, and for an axis that is empty or holds something twice.
    """
    named = [parse(configuration) for configuration in configurations]
    for what, values in (
        ("defenders", [slug(d) for d in defenders]),
        ("configurations", [n for n, _ in named]),
        ("seeds", seeds),
    ):
        if not values or len(set(values)) != len(values):
            raise ValueError(f"{what} must be distinct, and at least one; got {list(values)}")
    known = {f.name for f in fields(Recipe)} - {"defender", "seed"}
    for name, knobs in named:
        if not set(knobs) <= known:
            raise ValueError(f"configuration {name!r}: {sorted(set(knobs) - known)} are not among {sorted(known)}")
    return [
        Run(name, replace(base, defender=defender, seed=seed, **knobs), root)
        for seed, defender, (name, knobs) in product(seeds, defenders, named)
    ]


def sweep(runs: Sequence[Run], workers: int) -> Iterator[int]:
    """Train them all, `workers` at a time, one torch thread each; hands out the frames learned from, now and then.

    A run that is finished is not trained again, one that was killed goes on.
    """
    if workers == 1:
        for run in runs:
            _train(run)
            yield _learned(runs)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context, initializer=torch.set_num_threads, initargs=(1,)) as pool:
        futures: set[Future[None]] = {pool.submit(_train, run) for run in runs}
        try:
            while futures:
                done, futures = wait(futures, POLL)
                for future in done:
                    future.result()
                yield _learned(runs)
        finally:  # an error, or a caller who stops asking: start nothing new
            pool.shutdown(wait=False, cancel_futures=True)


def _train(run: Run) -> None:
    train(run.recipe, run.folder)


def _learned(runs: Sequence[Run]) -> int:
    return sum(int(run.curve[-1]["frames"]) for run in runs if run.curve)


def strongest(runs: Sequence[Run]) -> dict[str, Run]:
    """Of each defender, the run whose policy did most damage on the scenes held back."""
    best: dict[str, Run] = {}
    for run in sorted(runs, key=lambda run: run.best["damage"]):
        best[run.recipe.defender] = run
    return best


def keep(runs: Sequence[Run], folder: Path) -> list[Path]:
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
    damage: tuple[float, ...]  # per episode, of each seed's best policy
    excluded: tuple[float, ...]  # share of the liars that this policy had left out
    strongest: bool  # it holds the policy that is kept

    def row(self) -> str:
        damage, excluded = t_interval(list(self.damage)), t_interval(list(self.excluded))
        name = f"{self.configuration}{' (kept)' if self.strongest else ''}"
        figures = f"{format(damage, '.1f')} | {max(self.damage):.1f} | {format(excluded, '.2f')}"
        return f"| {self.defender} | {name} | {len(self.seeds)} | {figures} |"


def summarise(runs: Sequence[Run]) -> list[Line]:
    """One line a configuration and defender, in the order of the plan."""
    kept = {run.folder for run in strongest(runs).values()}
    groups: dict[tuple[str, str], list[Run]] = {}
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
    """`sweep.json` and `sweep.md` in `root`; the Markdown."""
    head = [
        "| defender | configuration | seeds | damage per episode | most | liars left out |",
        "|---|---|--:|---|--:|---|",
    ]
    text = "\n".join([*head, *(line.row() for line in lines)]) + "\n"
    (root / "sweep.md").write_text(text)
    (root / "sweep.json").write_text(
        json.dumps({"conditions": conditions, "lines": [asdict(line) for line in lines]}, indent=1)
    )
    return text
