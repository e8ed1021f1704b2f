"""Worst cases against an example worked by hand, and the laws of a maximum over scenes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cp_env.evaluation.analysis.worst_case import (
    average_precisions,
    damage_per_frame,
    damages,
    extremes,
    rank_attacks,
    rank_defenders,
)
from cp_env.metrics.intervals import t_interval
from tests.helpers.toy_evaluation import record
from tests.helpers.toy_grid import grids, made

# damage per frame by defender, attack and scene; AP is what is left of 1
DAMAGE = {
    "wall": {"loud": {"a": 0.2, "b": 0.8, "c": 0.5}, "sly": {"a": 0.6, "b": 0.4, "c": 0.5}},
    "fence": {"loud": {"a": 0.9, "b": 0.9, "c": 0.9}, "sly": {"a": 0.1, "b": 0.1, "c": 0.0}},
    "seer": {"loud": {"a": 0.1, "b": 0.1, "c": 0.1}, "sly": {"a": 0.1, "b": 0.1, "c": 0.1}},
}
AP = {d: {a: {s: 1 - x for s, x in of.items()} for a, of in by.items()} for d, by in DAMAGE.items()}


def test_the_worst_attack_of_each_scene_makes_a_defenders_score() -> None:
    wall, fence, seer = rank_defenders(DAMAGE, AP, informed=["seer"])
    assert (wall.entry, wall.rank, fence.entry, fence.rank, seer.entry, seer.rank) == (
        "wall",
        1,
        "fence",
        2,
        "seer",
        None,
    )
    assert wall.damage.mean == pytest.approx((0.6 + 0.8 + 0.5) / 3)  # sly in a, loud in b, a tie in c
    assert wall.damage.mean > max((0.2 + 0.8 + 0.5) / 3, (0.6 + 0.4 + 0.5) / 3)  # worse than under either attack
    assert wall.opponents == (("loud", 2), ("sly", 1))  # the first named has the tie
    assert fence.damage.mean == pytest.approx(0.9) and fence.opponents == (("loud", 3),)
    assert wall.ap50.mean == pytest.approx(1 - wall.damage.mean)
    assert wall.damage.low == pytest.approx(t_interval([0.6, 0.8, 0.5]).low)


def test_the_best_defence_of_each_scene_makes_an_attacks_score() -> None:
    loud, sly = rank_attacks(DAMAGE, AP, informed=["seer"])
    assert (loud.entry, loud.rank, sly.entry, sly.rank) == ("loud", 1, "sly", 2)
    assert loud.damage.mean == pytest.approx((0.2 + 0.8 + 0.5) / 3) and loud.opponents == (("wall", 3),)
    assert sly.damage.mean == pytest.approx((0.1 + 0.1 + 0.0) / 3) and sly.opponents == (("fence", 3),)
    assert sly.ap50.mean == pytest.approx(1 - sly.damage.mean)
    assert rank_attacks(DAMAGE, AP)[0].damage.mean == pytest.approx(0.1)  # unless the informed one counts


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
    (ranking,) = rank_defenders(alone, alone)
    assert (ranking.damage.low, ranking.damage.mean, ranking.damage.high) == (0.0, 0.5, 1.0)


def test_frames_of_grace_do_not_count_and_those_a_failed_defender_never_saw_are_lost() -> None:
    assert damage_per_frame(record("a", "1", 1, damage=(1.0, 0.5, 0.25)), 3) == pytest.approx(0.375)
    assert damage_per_frame(record("a", "1", 1, damage=(1.0, 0.5, 0.25), grace_frames=0), 3) == pytest.approx(1.75 / 3)
    failed = record("a", "1", 1, damage=(1.0, 0.5, 0.25), error="why")
    assert damage_per_frame(failed, 5) == pytest.approx((0.5 + 0.25 + 1 + 1) / 4)


# ── grids ────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_only_scenes_that_every_pair_has_played_are_compared(tmp_path: Path) -> None:
    base, *_ = grids(tmp_path)
    results = made(base, 0.4)
    run = next(run for run in results if (run.defender, run.attack) == ("d", "x"))
    results[run] = results[run][:1]
    table = damages(base, results)
    assert all(set(scenes) == {"toy-0"} for by in table.values() for scenes in by.values())
    assert average_precisions(base, results)["d"]["x"] == {"toy-0": 1.0}
    assert "none" not in table["d"]  # it is no attack
