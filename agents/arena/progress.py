"""Progress of the programs that play many runs: bars on a terminal, lines by the clock elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from cp_env import progress
from cp_env.evaluation import Conditions, Run
from cp_env.scenes import open_source

T = TypeVar("T")


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


def run_label(run: Run) -> str:
    """A run in a few words."""
    return f"{run.defender} against {run.attack}, k = {run.k}"


def announce(runs: int, stored: int, conditions: Conditions, workers: str) -> None:
    """Say what is to be played, before it is: the plan.

    Args:
        runs: of the plan.
        stored: those of them that need not be played again.
        conditions: their scenes and frames.
        workers: who plays, in words.
    """
    left = "the time left is told after the first" if runs > stored else "nothing is left to play"
    where = f"{conditions.frames} frames on {len(conditions.names)} scenes of {open_source(conditions.scenes).name}"
    progress.say(f"plan: {runs} runs ({stored} of them stored), {where}, {workers}; {left}")
