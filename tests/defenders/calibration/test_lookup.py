"""Which calibration a defender rests on, and the warning where it is another detector's."""

from __future__ import annotations

import subprocess
import sys
import warnings
from pathlib import Path

import pytest

import defenders
from cp_env.detector import load_detector
from cp_env.detector.protocol import fusion_of
from defenders.calibration import NotCalibrated, calibration_folder, calibration_for, own_file, write_part
from defenders.calibration.files import THRESHOLD_PARTS, read_calibration
from defenders.calibration.lookup import SHIPPED
from defenders.protocol import EgoFusion

NEEDS = ("prbi:threshold=calibrated", "robosac:threshold=calibrated", "pasac", "pasac:score=similarity", "bayes")
"""Defenders that rest on a calibration."""
NEEDS_NONE = ("prbi", "robosac", "none", "ego_only", "oracle", "bayes:likelihood=perfect", "pasac:epsilon=0.1")


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("CP_ENV_CALIBRATION", str(tmp_path))
    monkeypatch.setenv("CP_ENV_CALIBRATION_WARNED", "")
    return tmp_path


def test_the_folder_is_the_users_and_can_be_moved(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert calibration_folder() == folder and own_file("abc") == folder / "abc.json"
    monkeypatch.delenv("CP_ENV_CALIBRATION")
    assert calibration_folder().is_absolute() and "cp_env" in str(calibration_folder())


def test_shipped_weights_have_a_calibration_without_a_word() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for name in (*NEEDS, *NEEDS_NONE):
            defenders.make(name).configure(fusion=fusion_of(load_detector("max"), "mean"))
        found = calibration_for(fusion_of(load_detector("max"), "mean"), "densities")
    assert found.path == SHIPPED / "max.json"


def test_another_precision_shares_the_calibration() -> None:
    exact, rounded = load_detector("max"), load_detector("max").with_precision("bfloat16")
    assert exact.digest != rounded.digest and fusion_of(rounded, "mean").detector == fusion_of(exact, "mean").detector
    assert fusion_of(exact, "mean") == "max" and fusion_of(exact, "mean").detector == exact.digest


@pytest.mark.parametrize("name", NEEDS)
def test_a_defender_on_other_weights_says_so_once(name: str) -> None:
    stranger = EgoFusion("max", "0123456789abcdef")
    with pytest.warns(NotCalibrated, match=r"max\.json is of the detector .*0123456789abcdef.*cp-calibrate --detector"):
        defenders.make(name).configure(fusion=stranger)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        defenders.make(name).configure(fusion=stranger)


@pytest.mark.parametrize("name", NEEDS_NONE)
def test_a_defender_that_needs_none_says_nothing(name: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        defenders.make(name).configure(fusion=EgoFusion("max", "0123456789abcdef"))


def test_processes_that_are_started_say_nothing_again() -> None:
    """Workers of an arena inherit what was said."""
    code = (
        "import warnings, defenders\nfrom defenders.protocol import EgoFusion\nwarnings.simplefilter('error')\n"
        "defenders.make('bayes').configure(fusion=EgoFusion('sum', 'feed'))"
    )
    root = Path(defenders.__file__).parents[1]

    def fails() -> bool:
        return subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True).returncode != 0

    assert fails()
    with pytest.warns(NotCalibrated):
        defenders.make("bayes").configure(fusion=EgoFusion("sum", "feed"))
    assert not fails()


def test_the_users_calibration_of_these_weights_is_found(folder: Path) -> None:
    """For every part that it holds, shipped weights included; for the others, what ships serves, with a word."""
    for part in THRESHOLD_PARTS:
        write_part(own_file("feed"), "feed", "mean", part, {"epsilon": {1: 0.123}})
    mine = EgoFusion("mean", "feed")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for name in NEEDS[:-1]:
            defender = defenders.make(name)
            defender.configure(fusion=mine)
            assert defender.epsilon.epsilon == {1: 0.123}, name  # type: ignore[attr-defined]
    with pytest.warns(NotCalibrated, match="densities"):
        defenders.make("bayes").configure(fusion=mine)
    shipped = read_calibration(SHIPPED / "mean.json")
    write_part(own_file(shipped.detector), shipped.detector, "mean", "previous_frame", {"epsilon": {1: 0.321}})
    assert calibration_for(EgoFusion("mean", shipped.detector), "previous_frame").thresholds("previous_frame") == {
        1: 0.321
    }
    assert calibration_for("mean", "previous_frame").path == SHIPPED / "mean.json", "nothing is known of the weights"


def test_a_file_that_changes_is_read_again(folder: Path) -> None:
    for epsilon in (0.1, 0.25):
        write_part(own_file("feed"), "feed", "mean", "previous_frame", {"epsilon": {1: epsilon}})
        found = calibration_for(EgoFusion("mean", "feed"), "previous_frame")
        assert found.thresholds("previous_frame") == {1: epsilon}


def test_a_named_file_is_taken_and_doubted(folder: Path) -> None:
    """`prbi:threshold=FILE` and `bayes:likelihood=FILE`."""
    path = folder / "named.json"
    write_part(path, "abc", "mean", "previous_frame", {"epsilon": {1: 0.2, 2: 0.3}})
    defender = defenders.make(f"prbi:threshold={path}")
    defender.configure(fusion=EgoFusion("mean", "abc"))
    assert defender.epsilon.epsilon == {1: 0.2, 2: 0.3}  # type: ignore[attr-defined]
    with pytest.warns(NotCalibrated, match=r"named\.json"):
        defender.configure(fusion=EgoFusion("mean", "feed"))
    bayes = defenders.make(f"bayes:likelihood={SHIPPED / 'max.json'}")
    assert bayes.likelihood.most == 5  # type: ignore[attr-defined]


def test_a_broken_file_of_the_user_is_named(folder: Path) -> None:
    own_file("feed").write_text("{}")
    with pytest.raises(ValueError, match=r"broken calibration file .*feed\.json"):
        defenders.make("bayes").configure(fusion=EgoFusion("mean", "feed"))
