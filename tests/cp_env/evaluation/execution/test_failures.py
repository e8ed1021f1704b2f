"""Failures of plug-ins are reported once, together with their like, with the plug-in's file, line and traceback."""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from agents.arena import make_attack
from cp_env.evaluation import FailedRuns, Run, Store, Workers, execute, plan_runs
from cp_env.evaluation.execution.failures import EpisodeFailures, alike, group_failures
from defenders.failure import Failure
from tests.helpers.toy_evaluation import CONDITIONS, Grumpy, open_toy, record

CLUMSY = "tests.helpers.toy_evaluation:Clumsy"
GRUMPY = "tests.helpers.toy_evaluation:Grumpy"
HERE = "tests/helpers/toy_evaluation.py"
NO_RAY = pytest.mark.skipif(find_spec("ray") is None, reason="ray is not installed: pip install -e '.[ray]'")
WORKERS = [{}, {"processes": 2}, pytest.param({"ray": "local"}, marks=NO_RAY)]


class Stubborn(Grumpy):
    """Fails before its first frame."""

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        raise RuntimeError(f"{n_vehicles} vehicles? never")


def run(defender: str = "none", attack: str = "pgd", seed: int = 0) -> Run:
    return Run(defender, attack, 2, seed, ("a", "b"))


@pytest.mark.parametrize("executor", WORKERS, ids=["one", "processes", "ray"])
def test_an_attack_that_breaks_down_is_told_once(executor: dict[str, str], tmp_path: Path) -> None:
    runs = plan_runs(CONDITIONS, defenders=("none", "prbi"), attacks=(CLUMSY, "none"), ks=(1, 2), seeds=(7, 8), batch=2)
    workers = Workers(make_attack=make_attack, open_bank=open_toy, **executor)  # type: ignore[arg-type]
    with pytest.raises(FailedRuns) as caught:
        list(execute(runs, CONDITIONS, Store(tmp_path), workers))
    said = str(caught.value)
    (group,) = caught.value.groups
    assert said.startswith(f"8 of {len(runs)} runs failed, all others are stored:\n  attack {CLUMSY} failed in 8 of 8")
    assert f"RuntimeError: stumbled in frame 0, at {HERE}:" in said and group.failure.place.endswith(" in act")
    assert said.count("File ") == 1 and said.count("raise RuntimeError") == 1
    assert f'File "{HERE}", line {group.failure.place.split(":")[1].split()[0]}, in act' in said


@pytest.mark.parametrize("sealed", [False, True])
def test_a_defender_that_breaks_down_ends_its_episodes_and_is_told_once(
    sealed: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    conditions = replace(CONDITIONS, sealed=sealed)
    runs = plan_runs(conditions, defenders=(GRUMPY,), attacks=("none", "noise"), ks=(2,), seeds=(7,), batch=1)
    store = Store(tmp_path)
    list(execute(runs, conditions, store, Workers(make_attack=make_attack, open_bank=open_toy)))
    said = capsys.readouterr().err
    assert said.count(f"defender {GRUMPY} failed and ended its episode, first on toy-0 against none, k = 0") == 1
    assert said.count("the others go on: RuntimeError: no more, at") == 1 and said.count("raise RuntimeError") == 1
    assert f'File "{HERE}", line ' in said and "verification.py" not in said and "child.py" not in said
    for records in store.load(runs, conditions).values():
        for one in records:
            assert one.error is not None and one.failure is None, "the traceback is not stored"
            assert f"failed in frame 2: RuntimeError: no more, at {HERE}:" in one.error
            assert one.error.endswith(" in inspect") and "\n" not in one.error


def test_one_that_breaks_down_in_its_reset_is_named(tmp_path: Path) -> None:
    place = f"{__name__}:Stubborn"
    runs = plan_runs(CONDITIONS, defenders=(place,), attacks=("none",), ks=(2,), seeds=(7,), batch=1)
    message = f"defender {place} failed in 2 of 2 runs: DefenderError: .*never, at "
    with pytest.raises(FailedRuns, match=message) as caught:
        list(execute(runs, CONDITIONS, Store(tmp_path), Workers(make_attack=make_attack, open_bank=open_toy)))
    assert "in reset" in caught.value.groups[0].failure.place


def test_errors_that_differ_by_numbers_are_alike() -> None:
    assert alike("frame 3 of <A at 0x7f12ab>: 0.25") == alike("frame 12 of <A at 0x7f99>: 1")
    assert alike("KeyError: 'a'") != alike("KeyError: 'b'")


def test_groups_keep_apart_what_differs_by_entry_line_or_text() -> None:
    planned = [run(d, a, s) for d in ("none", "prbi") for a in ("x", "y") for s in (0, 1)]
    one = Failure("E: in frame 1", "m.py:1 in act", "  trace", "attack x")
    failed = [
        (planned[0], one),
        (planned[1], replace(one, reason="E: in frame 2")),
        (planned[4], replace(one, place="m.py:2 in act")),
        (planned[2], replace(one, entry="attack y")),
        (planned[5], replace(one, reason="F: in frame 1")),
    ]
    groups = list(group_failures(failed, planned))
    assert [(group.entry, len(group.runs), group.planned) for group in groups] == [
        ("attack x", 2, 4),
        ("attack x", 1, 4),
        ("attack y", 1, 4),
        ("attack x", 1, 4),
    ]
    head = "attack x failed in 2 of 4 runs: E: in frame 1, at m.py:1 in act"
    assert str(groups[0]) == f"{head}\n  in: none against x, k = 2, seed 0, on a, b; and 1 more\n    trace"


@pytest.mark.parametrize(
    ("failed", "entry", "planned"),
    [
        ([("none", "x")], "none against x", 1),
        ([("none", "x"), ("prbi", "x")], "attack x", 2),
        ([("none", "x"), ("none", "y")], "defender none", 2),
        ([("none", "x"), ("prbi", "y")], "several entries", 4),
    ],
)
def test_without_a_name_it_is_said_what_the_runs_have_in_common(
    failed: list[tuple[str, str]], entry: str, planned: int
) -> None:
    plan = [run(d, a) for d in ("none", "prbi") for a in ("x", "y")]
    (group,) = group_failures([(run(*pair), Failure("its process died")) for pair in failed], plan)
    assert (group.entry, group.planned) == (entry, planned)
    assert str(group).count("\n") == 1, "there is no traceback"


def test_each_kind_of_failure_is_said_once_for_each_defender(capsys: pytest.CaptureFixture[str]) -> None:
    ended = EpisodeFailures()
    broken = record("a", "1", 1, failure=Failure("E: in frame 1", "m.py:1 in inspect", "  trace"))
    ended.report(run(), [record("b", "1", 1), broken, broken])
    ended.report(run(seed=1), [replace(broken, failure=Failure("E: in frame 2", "m.py:1 in inspect"))])
    assert capsys.readouterr().err.count("defender none failed") == 1
    ended.report(run("prbi"), [broken])
    ended.report(run(), [replace(broken, failure=Failure("E: in frame 1", "m.py:2 in inspect"))])
    assert capsys.readouterr().err.count("failed and ended its episode, first on a against pgd, k = 2, seed 0") == 2
