"""A worker ends with whoever started it, also while it still imports; no other process is watched."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.campaign.processes import ROOT, alive

PROGRAM = """
import os, pathlib, sys, time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from cp_env.evaluation.execution.processes import in_processes
from cp_env.process import WorkerContext, end_with_parent

folder = pathlib.Path(__file__).parent
if __name__ == "__mp_main__":  # imported by a worker, before anything is called
    (folder / f"{os.getpid()}.worker").touch()
    time.sleep(600)

if __name__ == "__main__":
    if sys.argv[1] == "workers":
        list(in_processes(pow, [(2, 3), (3, 2)], 2, 1))
    elif sys.argv[1] == "pool":  # as for sweeps and for recordings
        with ProcessPoolExecutor(1, mp_context=WorkerContext(), initializer=end_with_parent) as pool:
            pool.submit(pow, 2, 3).result()
    else:  # a process of the user's own
        process = get_context("spawn").Process(target=pow, args=(2, 3))
        process.start()
        process.join()
"""


@pytest.mark.skipif(not Path("/proc/self/stat").is_file(), reason="finds the workers in /proc")
@pytest.mark.parametrize(("kind", "count"), [("workers", 2), ("pool", 1), ("other", 1)])
def test_a_worker_that_imports_ends_with_its_killed_parent(kind: str, count: int, tmp_path: Path) -> None:
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    parent = subprocess.Popen([sys.executable, str(program), kind], env=environment)
    deadline = time.monotonic() + 300
    while len(found := [int(file.stem) for file in tmp_path.glob("*.worker")]) < count:
        assert parent.poll() is None and time.monotonic() < deadline
        time.sleep(0.02)
    try:
        os.kill(parent.pid, signal.SIGKILL)
        parent.wait()
        deadline = time.monotonic() + 2
        while time.monotonic() < deadline and any(map(alive, found)):
            time.sleep(0.01)
        assert [alive(process) for process in found] == [kind == "other"] * count
    finally:
        for process in filter(alive, found):
            os.kill(process, signal.SIGKILL)
