"""The benchmark's report, and the program that writes it."""

from __future__ import annotations

import io
import json
import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from cp_env.evaluation import Run, Workers, about, screen, strata, summarise, write_report
from cp_env.evaluation.report.benchmark import metric_text
from tests.helpers.toy_evaluation import CONDITIONS, SOURCE, open_toy, record, rows_of


def test_the_report_says_how_to_make_it_again(whole: Path) -> None:
    data = json.loads((whole / "results.json").read_text())
    assert data["about"]["command"] == "python x.py"
    assert data["about"]["conditions"]["names"] == ["toy-0", "toy-1"]
    assert data["about"]["versions"]["torch"]
    assert len(data["rows"]) == 4
    text = (whole / "results.md").read_text()
    tables = [part.splitlines() for part in re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE)]
    assert len(tables) >= 2, "a short one, and one with intervals"
    for table in tables:
        assert len(table) == 2 + 4
        assert len({line.count("|") for line in table}) == 1


def test_a_rate_of_episodes_is_printed_with_its_count() -> None:
    row = rows_of(prbi__pgd=[record(str(i), "1", 1) for i in range(9)])["prbi__pgd"]
    assert metric_text(row, "convergence_rate", ".2f", interval=True) == "0 of 9 [0.00, 0.34]"
    assert metric_text(row, "convergence_rate", ".2f", interval=False) == "0 of 9"
    assert metric_text(row, "mc_rate", ".2f", interval=False) == "0.00"
    assert metric_text(row, "recovery50", ".2f", interval=True) == "–"


def test_both_cases_of_the_ego_are_in_the_report(tmp_path: Path) -> None:
    results = {Run("prbi", "pgd", 2, 0, ("a", "b")): [record("a", "1", 1, attackers=(0, 2)), record("b", "1", 1)]}
    parts = summarise(results, resamples=5), about(CONDITIONS, "x"), strata(results, resamples=5)
    assert "Failed episodes" not in write_report(tmp_path, *parts)[1].read_text()
    write_report(tmp_path, *parts, ["defender wall ended 1 of its 2 episodes: ```KeyError"])
    assert "defender wall ended 1 of its 2 episodes: '''KeyError\n```" in (tmp_path / "results.md").read_text()
    text = (tmp_path / "results.md").read_text()
    assert "Episodes in which the ego is benign:" in text and "Episodes in which the ego is an attacker:" in text
    data = json.loads((tmp_path / "results.json").read_text())
    assert [len(data["strata"][name]) for name in ("ego_benign", "ego_attacker")] == [1, 1]
    assert len(data["rows"]) == 1 and data["rows"][0]["n_episodes"] == 2


def test_the_table_fits_a_terminal_of_eighty_columns() -> None:
    rows = rows_of(
        none__none=[record("a", "1111", 4, attackers=())], prbi__pgd=[record("a", "10", 4), record("b", "10", 4)]
    )
    rows["long"] = replace(rows["prbi__pgd"], defender="prbi:threshold=calibrated", n_errors=2)
    console = Console(width=80, file=io.StringIO())
    console.print(screen(list(rows.values())))
    shown = console.file.getvalue()  # type: ignore[attr-defined]
    assert max(map(len, shown.splitlines())) <= 80
    assert "…" not in shown
    assert "no attack" in shown
    assert "pgd, 2 attackers" in shown


@pytest.fixture
def program(monkeypatch: pytest.MonkeyPatch) -> Any:
    """`examples/benchmark.py`, on the toy scenes."""
    monkeypatch.setattr(sys, "argv", ["benchmark.py"])
    from examples import benchmark

    monkeypatch.setattr("agents.arena.conditions.open_source", lambda _: SOURCE)
    monkeypatch.setattr("cp_env.evaluation.plan.runs.open_source", lambda _: SOURCE)
    monkeypatch.setattr(benchmark.evaluation, "open_bank", open_toy)
    monkeypatch.setattr(benchmark.evaluation, "Workers", lambda **options: Workers(**options, open_bank=open_toy))
    return benchmark


def test_the_program_writes_tables_and_a_video_and_goes_on(
    program: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    args = program.Args(frames=2, defenders=("none",), attacks=("none", "pgd:steps=1"), ks=(2,), out=tmp_path / "out")
    program.main(args)
    assert {"results.json", "results.md", "episode.gif", "runs"} == {file.name for file in (tmp_path / "out").iterdir()}
    assert "AP@.5" in capsys.readouterr().out
    stamps = {file: file.stat().st_mtime_ns for file in (tmp_path / "out" / "runs").iterdir()}
    program.main(replace(args, gif=False))
    assert stamps == {file: file.stat().st_mtime_ns for file in (tmp_path / "out" / "runs").iterdir()}


def test_the_program_refuses_more_scenes_than_there_are(program: Any, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="n_scenes must be 1 to 2"):
        program.main(program.Args(n_scenes=3, out=tmp_path))
