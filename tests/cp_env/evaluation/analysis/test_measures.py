"""Measures: which way is better, episodes cut short, and a further one that is a line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from cp_env.evaluation.analysis.measures import (
    MEASURES,
    Measure,
    critical_recall,
    damage_per_frame,
    episode_mean,
    measure_of,
)
from cp_env.evaluation.analysis.summary import summarise
from cp_env.evaluation.analysis.worst_case import measured, rank_defenders
from cp_env.evaluation.plan.driving_record import DrivingRecord
from cp_env.evaluation.plan.runs import Run
from tests.helpers.toy_evaluation import record
from tests.helpers.toy_grid import grids, made


def test_frames_of_grace_do_not_count_and_those_a_failed_defender_never_saw_are_lost() -> None:
    assert damage_per_frame(record("a", "1", 1, damage=(1.0, 0.5, 0.25)), 3) == pytest.approx(0.375)
    assert damage_per_frame(record("a", "1", 1, damage=(1.0, 0.5, 0.25), grace_frames=0), 3) == pytest.approx(1.75 / 3)
    failed = record("a", "1", 1, damage=(1.0, 0.5, 0.25), error="why")
    assert damage_per_frame(failed, 5) == pytest.approx((0.5 + 0.25 + 1 + 1) / 4)


@pytest.mark.parametrize("measure", MEASURES.values(), ids=lambda measure: measure.name)
def test_a_measure_is_a_share_whose_worst_value_is_its_greatest_loss(measure: Measure) -> None:
    for hits, damage in (("11", (0.0, 0.0)), ("10", (0.0, 0.5)), ("00", (1.0, 1.0))):
        value = measure.of_scene([record("a", hits, 2, damage=damage, verifications=(0, 0))], 2)
        assert value is None or 0 <= value <= 1
    assert measure.loss(measure.worst([0.2, 0.7])) == max(measure.loss(0.2), measure.loss(0.7))
    assert measure.loss(measure.best([0.2, 0.7])) == min(measure.loss(0.2), measure.loss(0.7))
    assert measure.name == measure_of(measure.name).name and MEASURES[measure.name] is measure


def test_an_unknown_measure_is_named_with_the_nearest() -> None:
    with pytest.raises(ValueError, match=r"unknown measure 'damge' \(did you mean 'damage'\?\): choose one of damage"):
        measure_of("damge")


def test_a_further_measure_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It then ranks, is a column of each row, and is None where it has no meaning."""
    value = episode_mean(lambda r: float(bool(r.suspects)) if r.attackers else None)
    flagged = Measure("flagged", "flagged", value, headline=True)
    monkeypatch.setitem(MEASURES, "flagged", flagged)
    base, *_ = grids(tmp_path)
    results = made(base, 0.4)
    for run in results:
        if run.defender == "d":
            results[run] = tuple(replace(r, suspects=()) for r in results[run])
    d, e = rank_defenders(measured(base, results), by="flagged")[::-1]
    assert (d.entry, d.value.mean, e.entry, e.value.mean) == ("d", 0.0, "e", 1.0)
    rows = {(row.defender, row.attack): row for row in summarise(results, resamples=10)}
    value = rows["e", "x"].value("flagged")
    assert value is not None and value.mean == 1.0  # type: ignore[union-attr]
    assert rows["e", "x"].to_json()["flagged"]["mean"] == 1.0 and "measures" not in rows["e", "x"].to_json()
    clean = summarise({Run("e", "none", 0, 0, ("a",)): [record("a", "1", 1, attackers=())]}, resamples=10)[0]
    assert clean.value("flagged") is None


def test_a_rate_counts_episodes_and_a_count_may_be_large() -> None:
    scenes = [[record("a", "1", 1), record("a", "1", 1, suspects=())], [record("b", "1", 1, suspects=())]]
    rate = Measure("found", "found", episode_mean(lambda r: float(bool(r.suspects))), kind="rate")
    share = Measure("found", "found", episode_mean(lambda r: float(bool(r.suspects))))
    count = Measure("asked", "asked", episode_mean(lambda r: float(sum(r.verifications))), kind="count")
    assert f"{rate.summary(scenes, 3):.2f}" == "1 of 3 [0.01, 0.91]"
    (of_scenes, asked) = share.summary(scenes, 3), count.summary(scenes, 3)
    assert of_scenes is not None and (of_scenes.mean, of_scenes.n) == (0.25, 2)
    assert asked is not None and asked.mean == 2.0 and count.loss(40.0) == 0.0
    none = Measure("none", "none", lambda records, frames: None, kind="rate")
    assert none.summary(scenes, 3) is None and share.summary([], 3) is None


def test_critical_recall_of_frames_that_a_failed_defender_never_saw_is_nothing() -> None:
    assert critical_recall([record("a", "1", 1)], 3) is None, "nothing was recorded"

    class Seen(DrivingRecord):
        def recall(self, grace: int) -> float | None:
            return 0.8 if grace == 1 else None

    whole, failed = (record("a", "1", 1, driving=object.__new__(Seen), error=error) for error in (None, "why"))
    assert critical_recall([whole], 3) == pytest.approx(0.8)
    assert critical_recall([whole, failed], 6) == pytest.approx((0.8 + 0.4) / 2)
