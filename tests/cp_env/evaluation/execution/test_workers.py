"""Workers do not matter: several processes or a Ray cluster give what one process gives, and outlive their dead."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path

import pytest

from agents.arena import make_attack
from cp_env.evaluation import FailedRuns, Store, Workers, execute, plan_runs
from cp_env.evaluation.execution.processes import Failure, in_processes
from tests.helpers.toy_evaluation import CONDITIONS, RUNS, open_toy, untimed

NO_RAY = pytest.mark.skipif(find_spec("ray") is None, reason="ray is not installed: pip install -e '.[ray]'")
WORKERS = [
    pytest.param({"processes": 2}, id="two-processes"),
    pytest.param({"ray": "local"}, id="ray", marks=NO_RAY),
]


@pytest.mark.parametrize("executor", WORKERS)
def test_workers_change_no_result_and_a_dead_one_costs_its_run(
    executor: dict[str, str], whole: Path, tmp_path: Path
) -> None:
    bad = plan_runs(
        CONDITIONS,
        defenders=("none",),
        attacks=("tests.helpers.toy_evaluation:Fatal", "tests.helpers.toy_evaluation:Clumsy"),
        ks=(2,),
        seeds=(7,),
    )
    workers = Workers(make_attack=make_attack, open_bank=open_toy, **executor)  # type: ignore[arg-type]
    store, done = Store(tmp_path), []
    with pytest.raises(FailedRuns, match=f"2 of {len(RUNS) + 2} runs failed, all others are stored") as caught:
        done.extend(execute([*bad, *reversed(RUNS)], CONDITIONS, store, workers))
    assert set(done) == set(RUNS)
    assert untimed(store.load(RUNS, CONDITIONS)) == untimed(Store(whole).load(RUNS, CONDITIONS))
    why = {run.attack.rpartition(":")[2]: reason for run, reason in caught.value.failed}
    assert why["Clumsy"] == "RuntimeError: stumbled in frame 0" and "died" in why["Fatal"]
    said = str(caught.value)
    assert "attack tests.helpers.toy_evaluation:Clumsy failed in 1 of 1 runs: RuntimeError: stumbled in frame 0" in said
    assert "in: none against tests.helpers.toy_evaluation:Clumsy, k = 2, seed 7, on toy-0, toy-1\n" in said
    again = plan_runs(
        CONDITIONS, defenders=("none",), attacks=("tests.helpers.toy_evaluation:Clumsy",), ks=(2,), seeds=(7,)
    )
    assert store.load(again, CONDITIONS) == {}  # a failed run is tried again by the next execution


def test_a_single_worker_goes_on_over_failures_too(tmp_path: Path) -> None:
    attacks = ("tests.helpers.toy_evaluation:Clumsy", "none")
    runs = plan_runs(CONDITIONS, defenders=("none",), attacks=attacks, ks=(2,), seeds=(7,))
    workers = Workers(make_attack=make_attack, open_bank=open_toy)
    with pytest.raises(FailedRuns, match="1 of 2 runs failed"):
        list(execute(runs, CONDITIONS, Store(tmp_path), workers))
    assert list(Store(tmp_path).load(runs, CONDITIONS)) == [run for run in runs if run.attack == "none"]


# -- workers end with whoever started them ----------------------------------------------------------------------------

ROOT = Path(__file__).parents[4]


def sleeping(folder: str, number: int) -> None:
    """A call that is long in C, which lets other threads run, as torch does."""
    (Path(folder) / f"{os.getpid()}").touch()
    time.sleep(600 + number)


def stuck(folder: str, number: int) -> None:
    """A call that holds the interpreter's lock in C for minutes, so that no other thread of its process ever runs."""
    (Path(folder) / f"{os.getpid()}").touch()
    pow(3, 10 ** (8 + number))


def quick(number: int) -> int:
    return number * number


def start(task: Callable[..., object], folder: Path, from_thread: bool = False) -> None:
    """Two workers that never finish; in a process of its own."""

    def work() -> None:
        list(in_processes(task, [(str(folder), 0), (str(folder), 1)], 2, 1))

    if from_thread:
        thread = threading.Thread(target=work)
        thread.start()
        thread.join()
    else:
        work()


def parent_of(folder: Path, task: str, from_thread: bool = False) -> tuple[subprocess.Popen[bytes], list[int]]:
    """A process whose two workers are at work, and their numbers."""
    code = (
        "import sys, pathlib; import tests.cp_env.evaluation.execution.test_workers as t; "
        f"t.start(t.{task}, pathlib.Path({str(folder)!r}), {from_thread})"
    )
    parent = subprocess.Popen([sys.executable, "-c", code], cwd=ROOT)
    deadline = time.monotonic() + 120
    while len(found := [int(file.name) for file in folder.iterdir()]) < 2:
        assert parent.poll() is None and time.monotonic() < deadline
        time.sleep(0.02)
    return parent, found


def alive(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


def gone_after(processes: Sequence[int], limit: float) -> float:
    """Seconds until none of them lives."""
    begin = time.monotonic()
    while any(map(alive, processes)):
        assert time.monotonic() - begin < limit, "a worker outlives its parent"
        time.sleep(0.01)
    return time.monotonic() - begin


NO_PROC = pytest.mark.skipif(not Path("/proc/self/stat").is_file(), reason="finds the workers in /proc")


@NO_PROC
@pytest.mark.parametrize(("task", "from_thread"), [("sleeping", False), ("sleeping", True), ("stuck", False)])
def test_workers_end_within_two_seconds_of_their_killed_parent(task: str, from_thread: bool, tmp_path: Path) -> None:
    if task == "stuck" and sys.platform != "linux":
        pytest.skip("only Linux's kernel ends a process whose threads cannot run")
    parent, workers = parent_of(tmp_path, task, from_thread)
    try:
        assert all(map(alive, workers))
        os.kill(parent.pid, signal.SIGKILL)
        parent.wait()
        assert gone_after(workers, 2.0) < 2.0
    finally:
        for process in workers:
            if alive(process):
                os.kill(process, signal.SIGKILL)


def late_but_first(folder: str, number: int) -> None:
    """The first call is over at once."""
    (Path(folder) / f"{os.getpid()}").touch()
    time.sleep(600 * number)


def leaves_a_thread(folder: str, number: int) -> None:
    """The call is over at once; its process cannot leave, as Python waits for a thread that the call has started."""
    (Path(folder) / f"{os.getpid()}").touch()
    threading.Thread(target=time.sleep, args=(600 + number,)).start()


@NO_PROC
@pytest.mark.parametrize(("task", "asked"), [(late_but_first, 1), (leaves_a_thread, 1), (leaves_a_thread, 3)])
def test_no_worker_outlives_whoever_stops_asking(task: Callable[..., None], asked: int, tmp_path: Path) -> None:
    """At work, idle or unable to leave; also after the last answer."""
    answers = in_processes(task, [(str(tmp_path), number) for number in range(2)], 2, 1)
    for _ in range(min(asked, 2)):
        next(answers)
    if asked > 2:
        assert list(answers) == []
    else:
        answers.close()  # type: ignore[attr-defined]
    workers = [int(file.name) for file in tmp_path.iterdir()]
    assert workers and not any(map(alive, workers))


def test_workers_outlive_the_thread_that_started_them() -> None:
    """Linux's signal is tied to the thread: one that ends must not take workers along that another still asks."""
    answers = in_processes(quick, [(n,) for n in range(4)], 1, 1)
    first: list[tuple[int, int | Failure]] = []
    thread = threading.Thread(target=lambda: first.append(next(answers)))
    thread.start()
    thread.join()
    assert first + list(answers) == [(n, n * n) for n in range(4)]
