"""Thresholds by group size, and for the ego's detector."""

from __future__ import annotations

from pathlib import Path

import pytest

import defenders
from defenders.calibration.files import write_part
from defenders.protocol import EgoFusion
from defenders.thresholds.tables import EGO_ONLY, PREVIOUS_FRAME, Thresholds, open_thresholds

PAIR = frozenset({0, 1})


def test_thresholds_by_size() -> None:
    epsilon = Thresholds({1: 0.2, 2: 0.4})
    assert [epsilon(frozenset(range(size))) for size in (1, 2, 3, 9)] == [0.2, 0.4, 0.4, 0.4]
    paper = open_thresholds("paper", 0.35)
    assert {paper(frozenset(range(size))) for size in range(1, 9)} == {0.35}
    assert open_thresholds({1: 0.1, 2: 0.3}, 0.35)(PAIR) == 0.3


@pytest.mark.parametrize("table", [{}, {2: 0.3}, {1: 0.3, 3: 0.4}, {1: 1.2}, {1: float("nan")}])
def test_impossible_thresholds_are_refused(table: dict[int, float]) -> None:
    with pytest.raises(ValueError, match="threshold"):
        Thresholds(table)


def test_only_calibrated_thresholds_follow_the_detector(tmp_path: Path) -> None:
    """Those of a named file as well; a mapping and the paper's are what they were."""
    fixed = Thresholds({1: 0.2, 2: 0.4})
    assert fixed.of(EgoFusion("max", "abc"))(PAIR) == open_thresholds("paper", 0.4).of("max")(PAIR) == 0.4
    path = tmp_path / "mine.json"
    write_part(path, "abc", "sum", PREVIOUS_FRAME, {"epsilon": {1: 0.11, 2: 0.22}})
    named = open_thresholds(str(path), 0.35)
    assert named(PAIR) == named.of(EgoFusion("sum", "abc"))(PAIR) == 0.22
    with pytest.raises(ValueError, match=r"mine\.json holds no ego_similarity, only previous_frame"):
        open_thresholds(str(path), 0.35, EGO_ONLY["similarity"])


def test_unknown_names_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="threshold must be"):
        open_thresholds("perhaps", 0.35)
    with pytest.raises(ValueError, match=r"no calibration file at .*nowhere\.json"):
        open_thresholds(str(tmp_path / "nowhere.json"), 0.35)


@pytest.mark.parametrize("options", [{}, {"threshold": "calibrated"}], ids=["default", "calibrated"])
@pytest.mark.parametrize("name", ["prbi", "robosac", "pasac"])
def test_thresholds_follow_the_configured_fusion(name: str, options: dict[str, str]) -> None:
    plain, configured, back = (defenders.make(name, **options) for _ in range(3))
    configured.configure(fusion="max")
    back.configure(fusion="max")
    back.configure(fusion="mean")
    tables = [defender.epsilon.epsilon for defender in (plain, configured, back)]  # type: ignore[attr-defined]
    calibrated = bool(options) or name == "pasac"
    assert tables[0] == tables[2] and (tables[0] != tables[1]) == calibrated
