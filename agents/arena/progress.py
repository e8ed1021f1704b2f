"""What the programs that play many cells share: which scenes, and bars on the screen."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from cp_env.evaluation import Cell

T = TypeVar("T")


def spread(names: Sequence[str], wanted: int | None) -> tuple[str, ...]:
    """So many of the scenes, spread evenly over the list; all for None. ValueError for more than there are."""
    wanted = len(names) if wanted is None else wanted
    if not 1 <= wanted <= len(names):
        raise ValueError(f"n_scenes must be 1 to {len(names)}, not {wanted}")
    return tuple(names[i * len(names) // wanted] for i in range(wanted))


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
