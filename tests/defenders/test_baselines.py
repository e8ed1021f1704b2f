"""The three bounds, the registry, and thresholds by group size."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import defenders
from cp_env.settings import FUSIONS
from defenders import EgoOnly, NoDefence, Oracle, Prbi
from defenders.simulation.world import PerfectWorld, play
from defenders.thresholds.tables import (
    CALIBRATED,
    EGO_ONLY,
    Thresholds,
    open_thresholds,
    read_thresholds,
    write_thresholds,
)


def test_none_fuses_everyone_and_pays_nothing() -> None:
    episode = play(NoDefence(), 5, 2, seed=0, max_frames=3)
    for ruling in episode.rulings:
        assert ruling.verdict == defenders.Verdict(range(5)) and ruling.verifications == 0


def test_ego_only_trusts_the_ego() -> None:
    episode = play(EgoOnly(), 5, 2, seed=0, max_frames=3)
    assert all(ruling.verdict == defenders.Verdict({0}) for ruling in episode.rulings)


def test_oracle_excludes_exactly_the_liars_at_once() -> None:
    for seed in range(10):
        episode = play(Oracle(), 5, 3, seed)
        assert len(episode.rulings) == 1 and episode.verifications == [0]
        assert episode.suspects == episode.liars


def test_oracle_told_by_its_constructor() -> None:
    oracle, world = Oracle(liars={1, 3}), PerfectWorld(4, frozenset({1, 3}))
    oracle.reset(4, np.random.default_rng(0))
    assert world.judge(oracle).verdict == defenders.Verdict({0, 2}, {1, 3}, True)
    assert oracle.belief().tolist() == [0, 1, 0, 1]


@pytest.mark.parametrize(("liars", "complaint"), [(None, "not told"), ({0, 1}, "fewer"), ({5}, "fewer")])
def test_oracle_needs_a_truth_that_can_be(liars: set[int] | None, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        Oracle(liars=liars).reset(2, np.random.default_rng(0))


def test_make_takes_names_objects_and_factories() -> None:
    assert isinstance(defenders.make("prbi", alpha=0.05), Prbi)
    finished = Prbi()
    assert defenders.make(finished) is finished
    assert isinstance(defenders.make(Prbi, alpha=0.05), Prbi)
    assert isinstance(defenders.make(lambda: Prbi(alpha=0.05)), Prbi)


def test_names_can_all_be_made() -> None:
    assert {"prbi", "none", "ego_only", "oracle"} <= set(defenders.names())
    for name in defenders.names():
        assert isinstance(defenders.make(name), defenders.Defender)


def test_an_unknown_name_lists_the_known_ones() -> None:
    with pytest.raises(ValueError, match=r"unknown defender 'pbri'; known are prbi, none, ego_only, oracle"):
        defenders.make("pbri")


def test_bad_doors() -> None:
    with pytest.raises(ValueError, match="cannot build defender 'none'"):
        defenders.make("none", epsilon=0.3)
    with pytest.raises(ValueError, match="takes no knobs"):
        defenders.make(Prbi(), epsilon=0.3)
    with pytest.raises(ValueError, match="built a dict"):
        defenders.make(dict)  # type: ignore[arg-type]


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


@pytest.mark.parametrize("knobs", [{}, {"threshold": "calibrated"}], ids=["default", "calibrated"])
@pytest.mark.parametrize("name", ["prbi", "robosac", "pasac"])
def test_who_compares_with_thresholds_takes_the_fusions(name: str, knobs: dict[str, str]) -> None:
    plain, told, back = (defenders.make(name, **knobs) for _ in range(3))
    told.configure(fusion="max")
    back.configure(fusion="max")
    back.configure(fusion="mean")
    tables = [defender.epsilon.epsilon for defender in (plain, told, back)]  # type: ignore[attr-defined]
    calibrated = bool(knobs) or name == "pasac"
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
