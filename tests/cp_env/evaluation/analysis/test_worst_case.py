"""Worst cases against an example worked by hand, screening, and the laws of a maximum over scenes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cp_env.evaluation.analysis.worst_case import (
    compare_defenders,
    extremes,
    measured,
    rank_attacks,
    rank_defenders,
    screened_attacks,
)
from cp_env.evaluation.plan.runs import Run
from cp_env.metrics.shares import share_interval
from tests.helpers.toy_grid import grids, made

# damage per frame by defender, attack and scene; AP is what is left of 1
DAMAGE = {
    "wall": {"loud": {"a": 0.2, "b": 0.8, "c": 0.5}, "sly": {"a": 0.6, "b": 0.4, "c": 0.5}},
    "fence": {"loud": {"a": 0.9, "b": 0.9, "c": 0.9}, "sly": {"a": 0.1, "b": 0.1, "c": 0.0}},
    "seer": {"loud": {"a": 0.1, "b": 0.1, "c": 0.1}, "sly": {"a": 0.1, "b": 0.1, "c": 0.1}},
}
AP = {d: {a: {s: 1 - x for s, x in of.items()} for a, of in by.items()} for d, by in DAMAGE.items()}
TABLES = {"damage": DAMAGE, "ap50": AP}


def test_the_worst_attack_of_each_scene_makes_a_defenders_score() -> None:
    wall, fence, seer = rank_defenders(TABLES, ["seer"])
    assert [(of.entry, of.rank) for of in (wall, fence, seer)] == [("wall", 1), ("fence", 2), ("seer", None)]
    assert wall.damage.mean == pytest.approx((0.6 + 0.8 + 0.5) / 3)  # sly in a, loud in b, a tie in c
    assert wall.damage.mean > max((0.2 + 0.8 + 0.5) / 3, (0.6 + 0.4 + 0.5) / 3)  # worse than under either attack
    assert wall.opponents == (("loud", 2), ("sly", 1))  # the first named has the tie
    assert fence.damage.mean == pytest.approx(0.9) and fence.opponents == (("loud", 3),)
    assert wall.ap50.mean == pytest.approx(1 - wall.damage.mean)
    assert wall.damage == share_interval([0.6, 0.8, 0.5]) and wall.value == wall.damage


def test_the_best_defence_of_each_scene_makes_an_attacks_score() -> None:
    loud, sly = rank_attacks(TABLES, ["seer"])
    assert (loud.entry, loud.rank, sly.entry, sly.rank) == ("loud", 1, "sly", 2)
    assert loud.damage.mean == pytest.approx((0.2 + 0.8 + 0.5) / 3) and loud.opponents == (("wall", 3),)
    assert sly.damage.mean == pytest.approx((0.1 + 0.1 + 0.0) / 3) and sly.opponents == (("fence", 3),)
    assert sly.ap50.mean == pytest.approx(1 - sly.damage.mean)
    assert rank_attacks(TABLES)[0].damage.mean == pytest.approx(0.1)  # unless the informed one counts


def test_another_measure_ranks_by_itself() -> None:
    """By AP the fence is ahead: the measures need not agree."""
    ap = {"wall": {"loud": {"a": 0.3}}, "fence": {"loud": {"a": 0.7}}}
    tables = {"damage": {"wall": {"loud": {"a": 0.1}}, "fence": {"loud": {"a": 0.4}}}, "ap50": ap}
    assert [of.entry for of in rank_defenders(tables)] == ["wall", "fence"]
    by_ap = rank_defenders(tables, by="ap50")
    assert [(of.entry, of.rank, of.by, of.value.mean) for of in by_ap] == [
        ("fence", 1, "ap50", 0.7),
        ("wall", 2, "ap50", 0.3),
    ]
    assert [of.value.mean for of in rank_attacks(tables, by="ap50")] == [0.7], "the best defence keeps the most"
    with pytest.raises(
        ValueError, match=r"unknown measure 'ap5' \(did you mean 'ap50'\?\): choose one of damage, ap50"
    ):
        rank_defenders({**tables, "ap5": ap}, by="ap5")


def test_a_screened_attack_is_the_one_of_every_scene_and_every_column() -> None:
    elsewhere = {
        "wall": {"loud": {"x": 0.1, "y": 0.2}, "sly": {"x": 0.9, "y": 0.1}},
        "fence": {"loud": {"x": 0.2, "y": 0.2}, "sly": {"x": 0.2, "y": 0.2}},
        "seer": {"loud": {"x": 0.0, "y": 0.0}, "sly": {"x": 0.1, "y": 0.0}},
    }
    screened = screened_attacks(elsewhere, "damage", DAMAGE)
    assert screened == {"wall": "sly", "fence": "loud", "seer": "sly"}, "means decide, and the first named has the tie"
    wall, fence, _ = rank_defenders(TABLES, ["seer"], screened=screened)
    assert wall.damage.mean == pytest.approx((0.6 + 0.4 + 0.5) / 3) and wall.opponents == (("sly", 3),)
    assert fence.ap50.mean == pytest.approx(0.1)
    looked_up = {of.entry: of.damage.mean for of in rank_defenders(TABLES)}
    assert all(of.damage.mean <= looked_up[of.entry] for of in (wall, fence)), "what is looked up is never milder"


def test_least_ap_is_worst_in_screening_and_what_was_not_met_is_not_picked() -> None:
    ap = {"wall": {"loud": {"x": 0.2}, "sly": {"x": 0.1}, "new": {"x": 0.0}}, "late": {"loud": {"x": 0.5}}}
    screened = screened_attacks(ap, "ap50", AP)
    assert screened == {"wall": "sly"}, "`new` was not played on the test scenes, `late` not at all"
    assert [of.entry for of in rank_defenders(TABLES, screened=screened, by="ap50")] == ["wall"]


def test_defenders_are_compared_over_the_same_scenes() -> None:
    (pair,) = compare_defenders({name: DAMAGE[name] for name in ("wall", "fence")}, "damage")
    assert (pair.first, pair.second) == ("wall", "fence")
    assert pair.interval.mean == pytest.approx((0.6 + 0.8 + 0.5) / 3 - 0.9)
    assert not pair.told_apart, "three scenes tell nobody apart"
    (screened,) = compare_defenders(
        {name: DAMAGE[name] for name in ("wall", "fence")}, "damage", {"wall": "sly", "fence": "sly"}
    )
    assert screened.interval.mean == pytest.approx(0.5 - 0.2 / 3)


def test_another_attack_never_helps_a_defender_nor_another_defence_an_attack() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        table = {a: {s: float(rng.random()) for s in "abcd"} for a in ("x", "y", "z")}
        fewer = {a: table[a] for a in ("x", "y")}
        for scene in "abcd":
            assert extremes(table, max)[scene][0] >= extremes(fewer, max)[scene][0]
            assert extremes(table, min)[scene][0] <= extremes(fewer, min)[scene][0]


def test_an_interval_of_a_share_stays_a_share() -> None:
    alone = {"d": {"x": {"a": 0.0, "b": 1.0}}}
    (ranking,) = rank_defenders({"damage": alone, "ap50": alone})
    assert 0 <= ranking.damage.low < 0.02 < ranking.damage.mean == 0.5 < 0.98 < ranking.damage.high <= 1


def test_the_fields_of_a_line_in_json() -> None:
    line = rank_defenders(TABLES)[0].to_json()
    assert {"entry", "rank", "damage", "ap50", "opponents", "by", "place"} == line.keys()
    assert line["damage"]["mean"] == pytest.approx(0.1) and line["place"]["rank"] == 1


# ── grids ────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_only_scenes_that_every_pair_has_played_are_compared(tmp_path: Path) -> None:
    base, *_ = grids(tmp_path)
    results = made(base, 0.4)
    run = next(run for run in results if (run.defender, run.attack) == ("d", "x"))
    results[run] = results[run][:1]
    tables = measured(base, results)
    assert all(set(scenes) == {"toy-0"} for by in tables["damage"].values() for scenes in by.values())
    assert tables["ap50"]["d"]["x"] == {"toy-0": 1.0}
    assert "none" not in tables["damage"]["d"]  # it is no attack


def test_only_seeds_that_every_pair_has_played_are_compared(tmp_path: Path) -> None:
    """A seed that is easier must not help the defender whose run of it did not fail."""
    base, *_ = grids(tmp_path)
    results = made(base, 0.4)
    for run, records in list(results.items()):
        easy = tuple(replace(r, damage=(0.0, 0.0)) for r in records)
        if run.defender == "d" and run.attack != "none":
            results[Run(run.defender, run.attack, run.k, 99, run.names)] = easy
    table = measured(base, results)["damage"]
    assert table["d"] == table["e"]
    for run, records in list(results.items()):
        if run.defender == "e" and run.attack != "none":
            results[Run(run.defender, run.attack, run.k, 99, run.names)] = tuple(
                replace(r, damage=(0.0, 1.0)) for r in records
            )
    table = measured(base, results)["damage"]
    assert table["d"]["x"]["toy-0"] == pytest.approx(0.2) and table["e"]["x"]["toy-0"] == pytest.approx(0.7)


def test_scenes_without_a_value_are_left_out_for_everybody(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from cp_env.evaluation.analysis import measures

    only = measures.Measure("only", "only", lambda records, frames: 0.5 if records[0].scene == "toy-1" else None)
    monkeypatch.setitem(measures.MEASURES, "only", only)
    base, *_ = grids(tmp_path)
    table = measured(base, made(base, 0.4), ["only"])["only"]
    assert table["d"] == {"x": {"toy-1": 0.5}, "y": {"toy-1": 0.5}}


def test_a_failed_run_does_not_hide_the_others(tmp_path: Path) -> None:
    base, *_ = grids(tmp_path)
    results = {run: of for run, of in made(base, 0.4).items() if (run.defender, run.attack) != ("d", "x")}
    lines = rank_defenders(measured(base, results))
    assert {of.entry for of in lines} == {"d", "e"}
