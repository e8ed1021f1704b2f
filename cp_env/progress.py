"""Progress of long work: a bar on a terminal; where the output is a file or a pipe, a line every so often.

Lines come by the clock, from a thread of their own: a step that takes minutes is not silent.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sized
from types import TracebackType
from typing import Protocol, TypeVar, runtime_checkable

from tqdm import tqdm

FIRST = 5.0
"""Seconds until the first line; what is done before it says nothing."""
EVERY = 30.0
"""Seconds between two lines."""

T = TypeVar("T")


@runtime_checkable
class Stream(Protocol):
    """What is written to: a file, a pipe or a terminal."""

    def write(self, text: str, /) -> int: ...
    def flush(self) -> None: ...
    def isatty(self) -> bool: ...


def say(text: str, stream: Stream | None = None) -> None:
    """Write a line on standard error, above the bars if there are any."""
    tqdm.write(text, file=stream or sys.stderr)
    (stream or sys.stderr).flush()


def duration(seconds: float) -> str:
    """Minutes and seconds, hours before them if there are any: "3:07", "1:02:00"."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"


class Progress:
    """A stage of a program that takes long, as a context manager.

    Args:
        what: is done, for the beginning of each line.
        total: steps; None if it is not known.
        unit: one step, in the singular.
        initial: steps that were done before, by a run that was stopped.
        stream: where bars and lines go; standard error by default.
        first: seconds until the first line.
        every: seconds between two lines.
        clock: measures seconds.
    """

    def __init__(
        self,
        what: str,
        total: int | None = None,
        unit: str = "step",
        *,
        initial: int = 0,
        stream: Stream | None = None,
        first: float = FIRST,
        every: float = EVERY,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.what, self.total, self.unit, self.done = what, total, unit, initial
        self._initial, self._stream, self._note = initial, stream or sys.stderr, ""
        self._first, self._every, self._clock, self._start = first, every, clock, clock()
        self._bar: tqdm[None] | None = None
        self._ended, self._thread = threading.Event(), threading.Thread(target=self._speak, daemon=True)

    def __enter__(self) -> Progress:
        self._start = self._clock()
        if self._stream.isatty():
            self._bar = tqdm(total=self.total, desc=self.what, unit=self.unit, initial=self._initial, file=self._stream)
        else:
            self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.close()
            return
        self._ended.set()
        self._thread.join()
        seconds = self._clock() - self._start
        if kind is None and seconds >= self._first:
            say(f"{self.what}: {self._count(self.done)} in {duration(seconds)}", self._stream)

    def advance(self, steps: int = 1, note: str = "") -> None:
        """Count steps that were done; `note` says which was the last."""
        self.to(self.done + steps, note)

    def to(self, done: int, note: str = "") -> None:
        """Count all steps that are done by now."""
        steps, self.done, self._note = done - self.done, done, note
        if self._bar is not None:
            if note:
                self._bar.set_postfix_str(note, refresh=False)
            self._bar.update(steps)

    def line(self) -> str:
        """How far it is: "playing: 3 of 40 runs after 2:05, about 25:41 left; prbi against pgd"."""
        seconds = self._clock() - self._start
        whole = self._count(self.done) if self.total is None else f"{self.done} of {self._count(self.total)}"
        made = self.done - self._initial
        left = ""
        if self.total is not None and made > 0:
            left = f", about {duration(seconds / made * max(self.total - self.done, 0))} left"
        return f"{self.what}: {whole} after {duration(seconds)}{left}{f'; {self._note}' if self._note else ''}"

    def _count(self, steps: int) -> str:
        return f"{steps} {self.unit}{'' if steps == 1 else 's'}"

    def _speak(self) -> None:
        """Lines until the end; the thread's whole life."""
        wait = self._first
        while not self._ended.wait(wait):
            say(self.line(), self._stream)
            wait = self._every


def track(items: Iterable[T], what: str, total: int | None = None, unit: str = "step") -> Iterator[T]:
    """The items, with their progress: one is done when the next is asked for."""
    if total is None and isinstance(items, Sized):
        total = len(items)
    with Progress(what, total, unit) as progress:
        for item in items:
            yield item
            progress.advance()
