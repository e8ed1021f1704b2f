"""`cp-benchmark`, on toy scenes; the example is in tests/cp_env/evaluation/report/test_benchmark.py."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from agents.commands.benchmark import Args, main, plan

TOY = ["--scenes", "tests.helpers.toy_scenes:ToySource:n_frames=3,n_connected=3", "--vehicles", "3", "--frames", "2"]


def test_the_program_says_its_plan_and_goes_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = [*TOY, "--ks", "1", "--defenders", "none", "ego_only", "--attacks", "none", "noise", "--out", str(tmp_path)]
    main([*words, "--no-gif"])
    told = capsys.readouterr()
    assert "plan: 4 runs (0 of them stored), 2 frames on 2 scenes of toy, processes: 1" in told.err
    assert "AP@.5" in told.out and "results.json" in told.out
    assert "cp-benchmark --scenes" in json.dumps(json.loads((tmp_path / "results.json").read_text()))
    main(words)
    assert "(4 of them stored)" in capsys.readouterr().err and (tmp_path / "episode.gif").exists()


def test_the_road_side_unit_shares_its_map(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--rsu", "--vehicles", "2", "--ks", "1", "--defenders", "none", "--attacks", "noise", "--no-gif"]
    main([*TOY, *words, "--out", str(tmp_path)])
    assert "2 vehicles and the road-side unit" in capsys.readouterr().out
    assert json.loads((tmp_path / "results.json").read_text())["about"]["conditions"]["rsu"] is True


def test_the_small_cut() -> None:
    conditions, runs = plan(Args(small=True).cut())
    assert len(conditions.names) == 3 and conditions.frames == 30 and {run.k for run in runs} == {0, 2}
    assert Args().cut() == Args()


def test_bad_input_is_told_in_one_line(tmp_path: Path) -> None:
    for words, told in (
        (["--defenders", "prib"], "unknown defender"),
        (["--n-scenes", "3"], "n_scenes must be 1 to 2"),
    ):
        with pytest.raises(SystemExit, match=f"cp-benchmark: {told}"):
            main([*TOY, "--ks", "1", "--out", str(tmp_path), *words])
