"""Progress bars of the programs that play many runs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from cp_env.evaluation import Run

T = TypeVar("T")


class Bars(Progress):
    """A bar for each stage of the program, and the last thing that was done."""

    def __init__(self, console: Console) -> None:
        super().__init__(
            TextColumn("{task.description:<10}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[last]}"),
            console=console,
        )

    def count(self, what: str, steps: Iterator[T], total: int, name: Callable[[T], str] = str) -> None:
        """Take all steps, and draw a bar of them meanwhile."""
        task = self.add_task(what, total=total, last="")
        for step in steps:
            self.update(task, advance=1, last=name(step))


def run_label(run: Run) -> str:
    """A run in a few words."""
    return f"{run.defender} against {run.attack}, k = {run.k}"
