"""A sweep's workers end with the process that started them. Its plan and tables are tested in `test_training.py`."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from agents.learning.sweep import TrainingRun
from agents.learning.training import Recipe

ROOT = Path(__file__).parents[3]
PARENT = """
import pathlib, sys
from agents.learning import sweep
from tests.agents.learning import test_sweep

if __name__ == "__main__":
    sweep._train = test_sweep.sleeps
    list(sweep.sweep(test_sweep.runs(pathlib.Path(sys.argv[1])), 2))
"""


def sleeps(run: TrainingRun) -> None:
    """In the place of the training: says which process it is in, and does not end."""
    (run.root / f"{os.getpid()}.worker").touch()
    time.sleep(600)


def runs(folder: Path) -> list[TrainingRun]:
    return [TrainingRun(f"run-{number}", Recipe(seed=number), folder) for number in range(2)]


def alive(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


@pytest.mark.skipif(not Path("/proc/self/stat").is_file(), reason="finds the workers in /proc")
def test_workers_end_with_their_killed_parent(tmp_path: Path) -> None:
    program = tmp_path / "program.py"
    program.write_text(PARENT)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    parent = subprocess.Popen([sys.executable, str(program), str(tmp_path)], cwd=ROOT, env=environment)
    workers: list[int] = []
    try:
        deadline = time.monotonic() + 120
        while len(workers) < 2:
            assert parent.poll() is None and time.monotonic() < deadline
            workers = [int(file.stem) for file in tmp_path.glob("*.worker")]
            time.sleep(0.05)
        assert all(map(alive, workers))
        os.kill(parent.pid, signal.SIGKILL)
        parent.wait()
        deadline = time.monotonic() + 5
        while any(map(alive, workers)):
            assert time.monotonic() < deadline, "a worker outlives its parent"
            time.sleep(0.02)
    finally:
        parent.kill()
        parent.wait()
        for process in filter(alive, workers):
            os.kill(process, signal.SIGKILL)
