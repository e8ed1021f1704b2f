"""Thresholds by group size and by fusion."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import defenders
from cp_env.settings import FUSIONS
from defenders.thresholds.tables import (
    CALIBRATED,
    EGO_ONLY,
    Thresholds,
    open_thresholds,
    read_thresholds,
    write_thresholds,
)


def test_thresholds_by_size() -> None:
    epsilon = Thresholds({1: 0.2, 2: 0.4})
    assert [epsilon(frozenset(range(size))) for size in (1, 2, 3, 9)] == [0.2, 0.4, 0.4, 0.4]
    paper = open_thresholds("paper", 0.35)
    assert {paper(frozenset(range(size))) for size in range(1, 9)} == {0.35}


@pytest.mark.parametrize("table", [{}, {2: 0.3}, {1: 0.3, 3: 0.4}, {1: 1.2}, {1: float("nan")}])
def test_impossible_thresholds_are_refused(table: dict[int, float]) -> None:
    with pytest.raises(ValueError, match="threshold"):
        Thresholds(table)


def test_thresholds_of_the_fusion() -> None:
    """Another fusion's take the default's place; one without an entry keeps the default, whatever was asked before."""
    thresholds = Thresholds({1: 0.2}, {"max": {1: 0.4}, "sum": {1: 0.6}})
    pair = frozenset({0, 1})
    assert [thresholds.of(name)(pair) for name in ("mean", "max", "sum", "yours")] == [0.2, 0.4, 0.6, 0.2]
    assert thresholds.of("max").of("yours")(pair) == thresholds(pair) == 0.2
    with pytest.raises(ValueError, match="threshold"):
        Thresholds({1: 0.2}, {"max": {2: 0.4}})


@pytest.mark.parametrize("path", [CALIBRATED, *EGO_ONLY.values()], ids=lambda path: path.stem)
def test_every_fusion_has_thresholds_of_its_own(path: Path) -> None:
    entries = json.loads(path.read_text())
    assert set(entries) == set(FUSIONS)
    assert all(
        sorted(entry["epsilon"]) == list("12345") and "calibration" in entry["source"] for entry in entries.values()
    )
    assert len({json.dumps(entry["epsilon"]) for entry in entries.values()}) == len(FUSIONS)


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


def test_thresholds_file(tmp_path: Path) -> None:
    path = tmp_path / "thresholds.json"
    write_thresholds(path, "mean", {1: 0.3, 2: 0.4}, source="here", command="this")
    first = path.read_text()
    write_thresholds(path, "max", {1: 0.1, 2: 0.2}, source="there", command="that")
    thresholds = read_thresholds(path)
    assert thresholds.epsilon == {1: 0.3, 2: 0.4} and thresholds.of("max").epsilon == {1: 0.1, 2: 0.2}
    assert json.loads(path.read_text())["mean"] == json.loads(first)["mean"]
    path.write_text(first.replace("mean", "max"))
    with pytest.raises(ValueError, match=r"thresholds\.json: KeyError\('mean'\)"):
        read_thresholds(path)
    broken_entries = ('{"epsilon": {"one": 0.3}}', '{"epsilon": {"2": 0.3}}', '{"epsilon": 3}')
    for broken in ("", "[]", "{}", *(f'{{"mean": {entry}}}' for entry in broken_entries)):
        path.write_text(broken)
        with pytest.raises(ValueError, match=str(path.name)):
            read_thresholds(path)
    with pytest.raises(ValueError, match="no calibrated thresholds"):
        read_thresholds(tmp_path / "nowhere.json")
