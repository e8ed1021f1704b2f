"""Calibration files: what is written is read, parts of other weights are dropped, and broken files are named."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from cp_env.detector import load_detector
from cp_env.settings import FUSIONS
from defenders.bayes.histograms import likelihood_of
from defenders.calibration.files import (
    FORMAT,
    MAX_BYTES,
    PARTS,
    THRESHOLD_PARTS,
    laid_out,
    read_calibration,
    write_part,
)
from defenders.calibration.lookup import SHIPPED


@pytest.mark.parametrize("fusion", FUSIONS)
def test_every_fusion_ships_a_whole_calibration_of_its_weights(fusion: str) -> None:
    """Measured with the weights that ship now: new weights need new measurements."""
    shipped = read_calibration(SHIPPED / f"{fusion}.json")
    assert (shipped.fusion, shipped.detector) == (fusion, load_detector(fusion).digest)
    assert set(shipped.parts) == set(PARTS)
    for part in THRESHOLD_PARTS:
        assert sorted(shipped.thresholds(part)) == [1, 2, 3, 4, 5]
    assert likelihood_of(shipped.densities()).most == 5
    assert all("calibration" in content["source"] and content["command"] for content in shipped.parts.values())


def test_shipped_calibrations_differ() -> None:
    tables = [read_calibration(SHIPPED / f"{fusion}.json").thresholds("previous_frame") for fusion in FUSIONS]
    assert len({repr(table) for table in tables}) == len(FUSIONS)


def test_parts_are_added_and_replaced(tmp_path: Path) -> None:
    path = tmp_path / "new" / "mine.json"
    write_part(path, "abc", "mean", "ego_similarity", {"source": "here", "epsilon": {1: 0.3, 2: 0.4}})
    write_part(path, "abc", "mean", "previous_frame", {"epsilon": {1: 0.1}})
    found = write_part(path, "abc", "mean", "ego_similarity", {"source": "there", "epsilon": {1: 0.5}})
    assert found == read_calibration(path) and found.path == path
    assert found.thresholds("ego_similarity") == {1: 0.5} and found.thresholds("previous_frame") == {1: 0.1}
    assert found.parts["ego_similarity"]["source"] == "there"
    assert [child.name for child in path.parent.iterdir()] == ["mine.json"], "no draft is left"


def test_parts_of_other_weights_are_dropped(tmp_path: Path) -> None:
    """Otherwise a file would say that it was measured with weights that only one of its parts was measured with."""
    path = tmp_path / "mine.json"
    write_part(path, "abc", "mean", "previous_frame", {"epsilon": {1: 0.1}})
    found = write_part(path, "def", "max", "ego_similarity", {"epsilon": {1: 0.2}})
    assert (found.detector, found.fusion, set(found.parts)) == ("def", "max", {"ego_similarity"})


def test_what_cannot_be_is_not_written(tmp_path: Path) -> None:
    path = tmp_path / "mine.json"
    with pytest.raises(ValueError, match="unknown part 'thresholds'"):
        write_part(path, "abc", "mean", "thresholds", {"epsilon": {1: 0.1}})
    for wrong in ({}, {2: 0.3}, {1: 1.5}, {1: float("nan")}):
        with pytest.raises(ValueError, match="threshold"):
            write_part(path, "abc", "mean", "previous_frame", {"epsilon": wrong})
    assert not path.exists()


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "{}",
        '{"format": "another"}',
        "[" * 100_000,
        " " * (MAX_BYTES + 1),
        json.dumps({"format": FORMAT, "detector": 3, "fusion": "mean"}),
        json.dumps(
            {"format": FORMAT, "detector": "abc", "fusion": "mean", "previous_frame": {"epsilon": {"one": 0.3}}}
        ),
        json.dumps({"format": FORMAT, "detector": "abc", "fusion": "mean", "previous_frame": {"epsilon": {"2": 0.3}}}),
        json.dumps({"format": FORMAT, "detector": "abc", "fusion": "mean", "ego_similarity": {"epsilon": 3}}),
        json.dumps({"format": FORMAT, "detector": "abc", "fusion": "mean", "ego_similarity": 3}),
    ],
    ids=lambda text: text[:60].strip() or "blank",
)
def test_a_broken_file_is_named(text: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.json"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"broken calibration file .*mine\.json.*cp-calibrate"):
        read_calibration(path)
    with pytest.raises(ValueError, match="no calibration file at"):
        read_calibration(tmp_path / "nowhere.json")


def test_lists_of_numbers_stand_on_one_line() -> None:
    stored = {"a": [[1, 2], [3]], "b": {"c": [0.5]}, "text": "no [list]\nhere"}
    text = laid_out(stored)
    assert json.loads(text) == stored and re.search(r"\[ ?1, 2 ?\]", text)
