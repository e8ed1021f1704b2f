"""The pipe to a process that answers a line with a line, within bounds of time and length.

Whatever the process does (it waits for ever, writes without end, hands its pipe to a child of its own), whoever asks is
answered or gets a `PipeError` in time.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import threading
import time
import weakref
from collections.abc import Sequence
from pathlib import Path
from queue import Empty, SimpleQueue

MAX_LINE = 1 << 20
"""Characters of one answer, at most."""

LEAVE = 1.0
"""Seconds that are waited for a process that says nothing any more, and for the pipe's thread after it was ended."""


class PipeError(RuntimeError):
    """The process ended, answered more than a line can hold, or gave no answer in time.

    Attributes:
        killed: whether somebody else killed it, as a system does that has no memory left. It may have been itself.
    """

    def __init__(self, message: str, *, killed: bool = False) -> None:
        super().__init__(message)
        self.killed = killed


class Pipe:
    """A process and the lines that are exchanged with it. It ends when this object is gone, or this process is.

    A thread writes and reads, so that nothing the process does can hold up who asks.

    Attributes:
        child: the process.
        killed: whether somebody else killed it.
    """

    def __init__(self, command: Sequence[str]) -> None:
        self.child = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            encoding="utf-8",
            cwd=Path.cwd(),
            start_new_session=True,  # so that its own children can be ended with it
        )
        self._messages: SimpleQueue[str | None] = SimpleQueue()
        self._lines: SimpleQueue[str] = SimpleQueue()
        arguments = (self.child, self._messages, self._lines)
        thread = threading.Thread(target=_converse, args=arguments, name="sealed pipe", daemon=True)
        thread.start()
        self.close = weakref.finalize(self, _end, self.child, self._messages, thread)
        self.killed = False

    def exchange(self, message: str, until: float) -> str:
        """Send a line, and wait for the line that answers it.

        Args:
            message: without its end of line.
            until: the moment, by `time.monotonic`, after which nothing is waited for.

        Returns:
            The answer, without its end of line.

        Raises:
            PipeError: there is none; the process is ended.
        """
        if not self.close.alive:
            raise PipeError(f"its process {'was killed' if self.killed else 'ended'}", killed=self.killed)
        self._messages.put(message)
        try:
            line = self._lines.get(timeout=max(until - time.monotonic(), 0.0))
        except Empty:
            self.close()
            raise PipeError("it gave no answer in time, and its process was ended") from None
        if not line.endswith("\n"):
            self.killed = _killed(self.child)
            self.close()
            why = "was killed" if self.killed else "ended, or answered more than a line can hold"
            raise PipeError(f"its process {why}", killed=self.killed)
        return line[:-1]


def _converse(child: subprocess.Popen[str], messages: SimpleQueue[str | None], lines: SimpleQueue[str]) -> None:
    """Write each message and read a line after it; an empty line when there is nothing to be read any more."""
    assert child.stdin is not None and child.stdout is not None
    with contextlib.suppress(OSError, ValueError), child.stdout, child.stdin:
        while (message := messages.get()) is not None:
            try:
                child.stdin.write(message + "\n")
                child.stdin.flush()
                line = child.stdout.readline(MAX_LINE)
            except (OSError, ValueError):  # ValueError: what it wrote is no text
                line = ""
            lines.put(line)


def _killed(child: subprocess.Popen[str]) -> bool:
    """Whether a process that says nothing any more was killed, before we end it."""
    with contextlib.suppress(subprocess.TimeoutExpired):
        return hasattr(signal, "SIGKILL") and child.wait(LEAVE) == -signal.SIGKILL
    return False


def _end(child: subprocess.Popen[str], messages: SimpleQueue[str | None], thread: threading.Thread) -> None:
    """End the process and what it started, and let the thread go."""
    with contextlib.suppress(OSError):
        if hasattr(os, "killpg"):
            os.killpg(child.pid, signal.SIGKILL)  # it leads a group of its own
    child.kill()
    child.wait()
    messages.put(None)
    thread.join(LEAVE)
