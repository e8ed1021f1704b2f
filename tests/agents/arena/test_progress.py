"""Bars on a terminal, lines elsewhere; the plan."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from agents.arena.progress import Bars, announce, run_label
from cp_env.evaluation import Conditions, Run
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
    assert (shown.getvalue() == "" and capsys.readouterr().err == "") != terminal, "three quick steps need no line"


def test_a_plan_says_what_is_left(capsys: pytest.CaptureFixture[str]) -> None:
    conditions = Conditions(ToySource(n_frames=3), ("toy-0", "toy-1"), frames=3)
    announce(7, 2, conditions, "processes: 4")
    assert "plan: 7 runs (2 of them stored), 3 frames on 2 scenes of toy, processes: 4; the time left" in (
        capsys.readouterr().err
    )
    announce(7, 7, conditions, "processes: 4")
    assert "nothing is left to play" in capsys.readouterr().err


def test_a_run_in_a_few_words() -> None:
    assert run_label(Run("prbi", "pgd", 2, 0, ("toy-0",))) == "prbi against pgd, k = 2"
