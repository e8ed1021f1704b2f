"""`cp-calibrate`; the measuring itself is in tests/agents/calibration, the whole way in test_your_data.py."""

from __future__ import annotations

from pathlib import Path

import pytest

from agents.commands.calibrate import Args, main, table
from defenders.calibration import own_file, read_calibration
from defenders.calibration.lookup import SHIPPED
from tests.helpers.toy_scenes import ToySource

SMALL = [
    "--scenes",
    "tests.helpers.toy_scenes:ToySource:n_frames=3,n_connected=3",
    "--vehicles",
    "3",
    "--attack",
    "noise",
]


def test_the_places_of_a_calibration(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CP_ENV_CALIBRATION", str(tmp_path))
    assert Args().path("abc") == own_file("abc") == tmp_path / "abc.json"
    assert Args(out=tmp_path / "mine.json").path("abc") == tmp_path / "mine.json"
    assert Args(shipped=True, fusion="max").path("abc") == SHIPPED / "max.json"
    with pytest.raises(ValueError, match="two places"):
        Args(shipped=True, out=tmp_path).path("abc")


def test_one_stage_into_a_file_that_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "mine.json"
    stage = ["--stages", "previous_frame", "--previous-frames", "2", "--n-scenes", "1", "--out", str(out)]
    main([*SMALL, *stage])
    told = capsys.readouterr()
    assert "plan: 3 episodes (previous_frame 3) of 1 scenes of toy, 3 vehicles" in told.err
    assert f"name it: prbi:threshold={out}" in told.out
    found = read_calibration(out)
    assert (
        set(found.parts) == {"previous_frame"} and "cp-calibrate --scenes" in found.parts["previous_frame"]["command"]
    )


def test_the_table_says_which_defenders_rest_on_what() -> None:
    shown = table(read_calibration(SHIPPED / "mean.json"))
    assert shown.row_count == 4 and next(iter(shown.columns[-1].cells)) == "prbi:threshold=calibrated"


def test_bad_input_is_told_in_one_line(tmp_path: Path) -> None:
    assert ToySource(n_connected=3).names() == ("toy-0", "toy-1")
    for words, told in (
        (["--n-scenes", "3"], "n_scenes must be 1 to 2"),
        (["--vehicles", "4"], "only 3 connected"),
        (["--detector", "mine"], "unknown detector 'mine'"),
        (["--weights", str(tmp_path / "no.safetensors")], "no weights at"),
    ):
        with pytest.raises(SystemExit, match=f"cp-calibrate: .*{told}"):
            main([*SMALL, "--out", str(tmp_path / "c.json"), *words])
