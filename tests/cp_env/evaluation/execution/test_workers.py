"""Workers do not matter: several processes or a Ray cluster give what one process gives, and outlive their dead."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import pytest

from agents.arena import make_attack
from cp_env.evaluation import FailedRuns, Store, Workers, execute, plan_runs
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
    assert "none against tests.helpers.toy_evaluation:Clumsy, k = 2, seed 7, on toy-0, toy-1: " in str(caught.value)
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
