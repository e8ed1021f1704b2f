"""Execution in processes of this machine. A process that dies costs the call it had, and no other."""

from __future__ import annotations

import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar

import torch

from cp_env.process import WorkerContext, end_with_parent
from cp_env.world.allocator import keep_freed_memory
from defenders.failure import Failure as Failure
from defenders.failure import failure_of

T = TypeVar("T")
Call = tuple[Any, ...]
_LEAVING = 1.0
"""Seconds for workers to leave by themselves, so that what plug-ins do at the end of a process is mostly done."""


def attempt(task: Callable[..., T], call: Call) -> T | Failure:
    """`task(*call)`, or why it failed. What is no `Exception` (a keyboard interrupt) is let through."""
    try:
        return task(*call)
    except Exception as error:
        return failure_of(error)


def in_processes(
    task: Callable[..., T], calls: Sequence[Call], workers: int, threads: int
) -> Iterator[tuple[int, T | Failure]]:
    """`task(*call)` for every call: its number and its result, as they come.

    No worker outlives the iteration, whether it comes to its end or is closed before. A worker ends with its parent,
    also if that is killed (see `cp_env.process`).
    """
    waiting, busy = deque(range(len(calls))), dict[Connection, tuple[BaseProcess, int]]()
    hired: list[BaseProcess] = []

    def hire() -> None:
        connection, process = _hire(threads)
        hired.append(process)
        send(connection, process)

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
            hire()
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
                        hire()
                yield number, result
    finally:  # at the end, and after an error, or if the caller stops asking
        for connection, (process, _) in busy.items():
            process.kill()
            connection.close()
        _see_off(hired)


def _see_off(processes: Sequence[BaseProcess]) -> None:
    """Wait until all have ended; one that still leaves after `_LEAVING` seconds is killed, as nobody needs it."""
    deadline = time.monotonic() + _LEAVING
    for process in processes:
        process.join(max(deadline - time.monotonic(), 0.0))
        process.kill()
        process.join()


def _hire(threads: int) -> tuple[Connection, BaseProcess]:
    """A new worker and the connection to it."""
    context = WorkerContext()
    ours, theirs = context.Pipe()
    lasting = threading.current_thread() is threading.main_thread()
    process = context.Process(target=_serve, args=(theirs, threads, lasting), daemon=True)
    process.start()
    theirs.close()
    return ours, process


def _serve(line: Connection, threads: int, by_signal: bool) -> None:
    """Answer calls until the connection is closed."""
    end_with_parent(by_signal=by_signal)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # an interrupt is the parent's to handle
    torch.set_num_threads(threads)
    keep_freed_memory()
    try:
        while True:
            task, call = line.recv()
            line.send(attempt(task, call))
    except (EOFError, ConnectionError):
        return
