"""Broken data is named: the file, the reason, and the scenes that were left out."""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest

from cp_env.scenes.errors import BrokenData, sift


def check(name: str) -> None:
    if name.startswith("bad"):
        raise BrokenData(Path(f"{name}.bin"), "cut short")


def test_it_says_file_and_reason_and_crosses_process_borders() -> None:
    error = BrokenData("a.bin", "cut short")
    again = pickle.loads(pickle.dumps(error))
    assert isinstance(error, ValueError) and str(error) == str(again) == "a.bin: cut short"
    assert (again.file, again.reason) == (Path("a.bin"), "cut short")


def test_the_first_broken_scene_stops_and_says_how_to_go_on() -> None:
    with pytest.raises(BrokenData, match=r"bad-1\.bin: cut short \(scene bad-1; .*skip_broken\)") as caught:
        sift(["good", "bad-1", "bad-2"], check, skip_broken=False)
    assert caught.value.file == Path("bad-1.bin")


def test_broken_scenes_are_left_out_and_told(capsys: pytest.CaptureFixture[str]) -> None:
    kept, left_out = sift(["a", "bad-1", "b", "bad-2"], check, skip_broken=True)
    assert kept == ("a", "b")
    assert [(left.scene, left.file, left.reason) for left in left_out] == [
        ("bad-1", Path("bad-1.bin"), "cut short"),
        ("bad-2", Path("bad-2.bin"), "cut short"),
    ]
    assert "left out scene bad-2: bad-2.bin: cut short" in "".join(capsys.readouterr())


def test_other_errors_are_not_taken_for_broken_data() -> None:
    def fault(name: str) -> None:
        raise KeyError(name)

    with pytest.raises(KeyError):
        sift(["a"], fault, skip_broken=True)


def test_nothing_left_is_an_error_and_nothing_asked_is_none() -> None:
    with pytest.raises(ValueError, match=r"every scene is broken; the first: left out scene bad: bad\.bin"):
        sift(["bad"], check, skip_broken=True)
    assert sift([], check, skip_broken=False) == ((), ())
