"""Bars on a terminal, lines elsewhere; the plan."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from rich.console import Console

from agents.arena.progress import Bars, announce, examined, least_time, run_label
from cp_env.evaluation import Conditions, Run, Store
from tests.helpers.toy_evaluation import record
from tests.helpers.toy_scenes import ToySource


@pytest.mark.parametrize("terminal", [True, False])
def test_all_steps_are_taken(terminal: bool, capsys: pytest.CaptureFixture[str]) -> None:
    shown, taken = io.StringIO(), []

    def name(step: int) -> str:
        taken.append(step)
        return f"step {step}"

    with Bars(Console(file=shown, force_terminal=terminal, width=120)) as bars:
        bars.count("playing", iter(range(3)), 3, name, unit="run")
    assert taken == [0, 1, 2]
    assert ("playing" in shown.getvalue() and "3/3" in shown.getvalue()) == terminal
    words = shown.getvalue().strip()  # older versions of rich end an invisible bar with an empty line
    assert (words == "" and capsys.readouterr().err == "") != terminal, "three quick steps need no line"


@pytest.mark.parametrize("terminal", [True, False])
def test_a_piece_of_work_returns_what_it_made(terminal: bool) -> None:
    shown = io.StringIO()
    with Bars(Console(file=shown, force_terminal=terminal, width=120)) as bars:
        assert bars.during("tables", lambda: [1, 2]) == [1, 2]
        with pytest.raises(KeyError):
            bars.during("tables", lambda: {}["none"])
    assert ("tables" in shown.getvalue() and "1/1" in shown.getvalue()) == terminal


def test_a_plan_says_what_is_left(capsys: pytest.CaptureFixture[str]) -> None:
    conditions = Conditions(ToySource(n_frames=3), ("toy-0", "toy-1"), frames=3)
    runs = [Run("none", "none", 0, seed, conditions.names) for seed in range(7)]
    kept = (record("toy-0", "1", 1),)
    announce([(run, kept if run.seed < 2 else None) for run in runs], conditions, "processes: 4")
    assert "plan: 7 runs (2 of them stored), 3 frames on 2 scenes of toy, processes: 4; the time left" in (
        capsys.readouterr().err
    )
    announce([(run, kept) for run in runs], conditions, "processes: 4", 4)
    assert "nothing is left to play" in capsys.readouterr().err


def test_a_plan_says_the_least_time_that_stored_runs_speak_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By hand: none took 4 s and 8 s, prbi 20 s; missing are one of each and one of a third, 6 + 20 + 13 s."""
    conditions, store = Conditions(ToySource(n_frames=3), ("toy-0", "toy-1"), frames=3), Store(tmp_path)
    runs = [Run(d, "none", 0, seed, conditions.names) for seed in range(3) for d in ("none", "prbi", "bayes")]
    jobs = [(run, conditions, store) for run in (*runs[:5], runs[6])]
    assert least_time(examined(jobs), 2) is None, "nothing is stored"
    for run, seconds in ((runs[0], 2.0), (runs[3], 4.0), (runs[1], 10.0)):
        made = [record(name, "1", 1, attackers=(), suspects=(), seconds=seconds) for name in run.names]
        store.write(run, conditions, made)
    found = examined(jobs)
    assert least_time(found, 1) == 6.0 + 20.0 + 13.0 and least_time(found, 2) == 39.0 / 2
    assert least_time(found, 8) == 39.0 / 3, "no more processes than runs"
    assert least_time(found[:1], 1) is None, "nothing is missing"
    announce(found, conditions, "processes: 1", 1)
    assert "processes: 1; at least 0:39, the attacks' own time left out, by the stored runs" in capsys.readouterr().err


def test_a_run_in_a_few_words() -> None:
    assert run_label(Run("prbi", "pgd", 2, 0, ("toy-0",))) == "prbi against pgd, k = 2"
