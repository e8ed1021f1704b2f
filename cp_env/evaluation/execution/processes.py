"""Execution in processes of this machine. A process that dies costs the call it had, and no other."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar

import torch

from cp_env.world.allocator import keep_freed_memory
from defenders.failure import Failure as Failure
from defenders.failure import failure_of

T = TypeVar("T")
Call = tuple[Any, ...]
_PR_SET_PDEATHSIG = 1  # of Linux's prctl: a signal when the parent's thread ends that started this process


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

    A worker ends with its parent, also if that is killed (see `end_with_parent`).
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
        for connection, (process, _) in busy.items():
            process.kill()
            connection.close()
        for process, _ in busy.values():
            process.join()


def _hire(threads: int) -> tuple[Connection, BaseProcess]:
    """A new worker and the connection to it."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    lasting = threading.current_thread() is threading.main_thread()
    process = context.Process(target=_serve, args=(theirs, threads, lasting), daemon=True)
    process.start()
    theirs.close()
    return ours, process


def end_with_parent(*, by_signal: bool = False) -> None:
    """Let this process end as soon as the one that started it has ended, however that came about.

    A thread waits for the parent's end; it needs Python to take turns between threads. It does nothing in a process
    that `multiprocessing` did not start. Give it to a pool of processes as `initializer`.

    Args:
        by_signal: on Linux, have the kernel kill this process, too, which needs no thread of ours. That is tied to the
            thread that started the process: only for one that lives as long as its process, the main thread.
    """
    parent = multiprocessing.parent_process()
    if parent is None:
        return
    if by_signal and sys.platform == "linux":
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)

    def watch(sentinel: int) -> None:
        wait([sentinel])
        os._exit(1)

    threading.Thread(target=watch, args=(parent.sentinel,), name="parent's end", daemon=True).start()


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
