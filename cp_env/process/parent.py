"""The end of worker processes with whoever started them, however that came about, from their first import on."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal
import sys
import threading
import time
from contextlib import suppress
from multiprocessing.connection import wait
from multiprocessing.context import SpawnContext, SpawnProcess
from typing import Any

WORKER = "cp_env worker of "
"""How the name of a worker begins; the number of the process that started it follows."""

WATCH = 0.2
"""Seconds after which a worker that imports asks again who its parent is."""

_PR_SET_PDEATHSIG = 1  # of Linux's prctl: a signal when the parent's thread ends that started this process


def end_with_parent(*, by_signal: bool = False) -> None:
    """Let this process end as soon as the one that started it has ended, however that came about.

    A thread waits for the parent's end; it needs Python to take turns between threads. It does nothing in a process
    that `multiprocessing` did not start. Give it to a pool of processes as `initializer`, and `WorkerContext()` as its
    context.

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


class Worker(SpawnProcess):
    """A spawned process whose name says who started it, so that it ends with its parent while it imports, too."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **{**options, "name": f"{WORKER}{os.getpid()}"})


class WorkerContext(SpawnContext):
    """The context of such processes, for a pool as well."""

    Process = Worker


def watch_in_worker() -> None:
    """In a process of a `Worker`, end with the parent from now on; nothing in any other.

    A spawned process imports the main module of the program, and torch with it, before anything of ours is called:
    seconds, or a minute on a busy machine, in which the parent may be killed. So the package calls this when it is
    imported. `multiprocessing` knows no parent yet at that time; the system does.
    """
    name = multiprocessing.current_process().name
    if not name.startswith(WORKER):
        return
    parent = int(name.removeprefix(WORKER))

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH)
        os._exit(1)

    threading.Thread(target=watch, name="parent's end, while importing", daemon=True).start()
