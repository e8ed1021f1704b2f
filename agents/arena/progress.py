"""Bars on the screen of the programs that play many cells."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from cp_env.evaluation import Cell

T = TypeVar("T")


class Bars(Progress):
    """A bar for each stage of a run, with what was done last beside it."""

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


def duel(cell: Cell) -> str:
    """A cell in a few words."""
    return f"{cell.defender} against {cell.attack}, k = {cell.k}"
