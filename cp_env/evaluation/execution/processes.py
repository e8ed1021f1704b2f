"""Execution in processes of this machine. A process that dies costs the call it had, and no other."""

from __future__ import annotations

import multiprocessing
import signal
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar

import torch

T = TypeVar("T")
Call = tuple[Any, ...]


@dataclass(frozen=True)
class Failure:
    """The failure of a call, in the place of its result."""

    reason: str


def attempt(task: Callable[..., T], call: Call) -> T | Failure:
    """`task(*call)`, or why it failed. What is no `Exception` (a keyboard interrupt) is let through."""
    try:
        return task(*call)
    except Exception as error:
        return Failure(f"{type(error).__name__}: {error}")


def in_processes(
    task: Callable[..., T], calls: Sequence[Call], workers: int, threads: int
) -> Iterator[tuple[int, T | Failure]]:
    """`task(*call)` for every call: its number and its result, as they come.

    A worker whose parent was killed ends by itself once no one receives its answer.
    """
    waiting, busy = deque(range(len(calls))), dict[Connection, tuple[BaseProcess, int]]()

    def send(connection: Connection, process: BaseProcess) -> None:
        if waiting:
            number = waiting.popleft()
            busy[connection] = process, number
            with suppress(ConnectionError):  # a worker that has just died answers nothing: its call has failed
                connection.send((task, calls[number]))
        else:
            connection.close()

    try:
        for _ in range(min(workers, len(calls))):
            send(*_hire(threads))
        while busy:
            for connection in wait(list(busy)):
                assert isinstance(connection, Connection)
                process, number = busy.pop(connection)
                try:
                    result: T | Failure = connection.recv()
                    send(connection, process)
                except (EOFError, ConnectionError):
                    process.join()
                    result = Failure(f"its process died (exit code {process.exitcode})")
                    if waiting:
                        send(*_hire(threads))
                yield number, result
    finally:  # an error, or a caller that stops asking
        for process, _ in busy.values():
            process.terminate()


def _hire(threads: int) -> tuple[Connection, BaseProcess]:
    """A new worker and the connection to it."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(theirs, threads), daemon=True)
    process.start()
    theirs.close()
    return ours, process


def _serve(line: Connection, threads: int) -> None:
    """Answer calls until the connection is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # an interrupt is the parent's to handle
    torch.set_num_threads(threads)
    try:
        while True:
            task, call = line.recv()
            line.send(attempt(task, call))
    except (EOFError, ConnectionError):
        return
