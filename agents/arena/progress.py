"""Progress of the programs that play many runs: bars on a terminal, lines by the clock elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from cp_env import progress
from cp_env.evaluation import Conditions, Record, Run
from cp_env.evaluation.plan.grid import Job
from cp_env.scenes import open_source

T = TypeVar("T")
R = TypeVar("R")


class Bars(Progress):
    """A bar for each stage of the program, and the last thing that was done; lines where there is no terminal."""

    def __init__(self, console: Console) -> None:
        super().__init__(
            TextColumn("{task.description:<10}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[last]}"),
            console=console,
            disable=not console.is_terminal,
        )

    def count(
        self, what: str, steps: Iterator[T], total: int, name: Callable[[T], str] = str, unit: str = "run"
    ) -> None:
        """Take all steps, and show how far they are meanwhile; `name` says which was the last."""
        if self.disable:
            with progress.Progress(what, total, unit) as lines:
                for step in steps:
                    lines.advance(note=name(step))
            return
        task = self.add_task(what, total=total, last="")
        for step in steps:
            self.update(task, advance=1, last=name(step))

    def during(self, what: str, work: Callable[[], R]) -> R:
        """Do a piece of work in one step, and say meanwhile that it goes on; returns what it returns."""
        found: list[R] = []

        def step() -> Iterator[None]:
            found.append(work())
            yield

        self.count(what, step(), 1, lambda _: "", "step")
        return found[0]


def run_label(run: Run) -> str:
    """A run in a few words."""
    return f"{run.defender} against {run.attack}, k = {run.k}"


def examined(jobs: Sequence[Job]) -> list[tuple[Run, tuple[Record, ...] | None]]:
    """Each run, with its episodes if they are stored and need not be played again."""
    found = [(run, store.examine(run, conditions)) for run, conditions, store in jobs]
    return [(run, records if isinstance(records, tuple) else None) for run, records in found]


def least_time(found: Sequence[tuple[Run, tuple[Record, ...] | None]], processes: int) -> float | None:
    """Seconds that the runs which are missing take at least, by those that are stored.

    A record holds how long the world's steps took, without the attack. So this is less than the whole. A defender that
    has no stored run is taken for the mean of the others.

    Args:
        found: runs of the plan, as `examined` gives them.
        processes: that play at once.

    Returns:
        The time, or None if nothing is stored or nothing is missing.
    """
    took: dict[str, list[float]] = {}
    missing = []
    for run, records in found:
        if records is None:
            missing.append(run.defender)
        else:
            took.setdefault(run.defender, []).append(sum(record.seconds for record in records))
    if not took or not missing:
        return None
    means = {defender: sum(of) / len(of) for defender, of in took.items()}
    typical = sum(means.values()) / len(means)
    return sum(means.get(defender, typical) for defender in missing) / min(processes, len(missing))


def announce(
    found: Sequence[tuple[Run, tuple[Record, ...] | None]],
    conditions: Conditions,
    workers: str,
    processes: int | None = None,
) -> None:
    """Say what is to be played, before it is: the plan.

    Args:
        found: runs of the plan, as `examined` gives them.
        conditions: their scenes and frames.
        workers: who plays, in words.
        processes: that play at once, if that is known.
    """
    stored = sum(records is not None for _, records in found)
    least = None if processes is None else least_time(found, processes)
    left = "the time left is told after the first" if len(found) > stored else "nothing is left to play"
    if least is not None:
        left = f"at least {progress.duration(least)}, the attacks' own time left out, by the stored runs"
    where = f"{conditions.frames} frames on {len(conditions.names)} scenes of {open_source(conditions.scenes).name}"
    progress.say(f"plan: {len(found)} runs ({stored} of them stored), {where}, {workers}; {left}")
