"""Worst cases against an example worked by hand, and the laws of a maximum over scenes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cp_env.evaluation import Cell, Record, Store
from cp_env.evaluation.analysis.curves import curves
from cp_env.evaluation.analysis.worst_case import (
    damage_a_frame,
    damages,
    extremes,
    precisions,
    rank_attackers,
    rank_defenders,
)
from cp_env.evaluation.plan.grid import Axes, Board, turns_of
from cp_env.metrics.intervals import t_interval
from tests.helpers.toy_evaluation import PROTOCOL, record

# damage a frame by defender, attack and scene; AP is what is left of 1
DAMAGE = {
    "wall": {"loud": {"a": 0.2, "b": 0.8, "c": 0.5}, "sly": {"a": 0.6, "b": 0.4, "c": 0.5}},
    "fence": {"loud": {"a": 0.9, "b": 0.9, "c": 0.9}, "sly": {"a": 0.1, "b": 0.1, "c": 0.0}},
    "seer": {"loud": {"a": 0.1, "b": 0.1, "c": 0.1}, "sly": {"a": 0.1, "b": 0.1, "c": 0.1}},
}
AP = {d: {a: {s: 1 - x for s, x in of.items()} for a, of in by.items()} for d, by in DAMAGE.items()}


def test_the_worst_attack_of_each_scene_makes_a_defenders_standing() -> None:
    wall, fence, seer = rank_defenders(DAMAGE, AP, told=["seer"])
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


def test_the_best_defence_of_each_scene_makes_an_attackers_standing() -> None:
    loud, sly = rank_attackers(DAMAGE, AP, told=["seer"])
    assert (loud.entry, loud.rank, sly.entry, sly.rank) == ("loud", 1, "sly", 2)
    assert loud.damage.mean == pytest.approx((0.2 + 0.8 + 0.5) / 3) and loud.opponents == (("wall", 3),)
    assert sly.damage.mean == pytest.approx((0.1 + 0.1 + 0.0) / 3) and sly.opponents == (("fence", 3),)
    assert sly.ap50.mean == pytest.approx(1 - sly.damage.mean)
    assert rank_attackers(DAMAGE, AP)[0].damage.mean == pytest.approx(0.1)  # unless the one that is told may count


def test_another_attack_never_helps_a_defender_nor_another_defence_an_attacker() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        table = {a: {s: float(rng.random()) for s in "abcd"} for a in ("x", "y", "z")}
        fewer = {a: table[a] for a in ("x", "y")}
        for scene in "abcd":
            assert extremes(table, max)[scene][0] >= extremes(fewer, max)[scene][0]
            assert extremes(table, min)[scene][0] <= extremes(fewer, min)[scene][0]


def test_an_interval_of_a_share_stays_a_share() -> None:
    alone = {"d": {"x": {"a": 0.0, "b": 1.0}}}
    (standing,) = rank_defenders(alone, alone)
    assert (standing.damage.low, standing.damage.mean, standing.damage.high) == (0.0, 0.5, 1.0)


def test_frames_of_grace_do_not_count_and_those_a_failed_defender_never_saw_are_lost() -> None:
    assert damage_a_frame(record("a", "1", 1, damage=(1.0, 0.5, 0.25)), 3) == pytest.approx(0.375)
    assert damage_a_frame(record("a", "1", 1, damage=(1.0, 0.5, 0.25), grace_frames=0), 3) == pytest.approx(1.75 / 3)
    failed = record("a", "1", 1, damage=(1.0, 0.5, 0.25), error="why")
    assert damage_a_frame(failed, 5) == pytest.approx((0.5 + 0.25 + 1 + 1) / 4)


# ── boards ───────────────────────────────────────────────────────────────────────────────────────────────────────────

AXES = Axes(defenders=("d", "e"), attacks=("x", "y"), ks=(2, 1), budgets=(0.3, 0.1), side_attacks=("x",))


def boards(folder: Path, axes: Axes = AXES) -> list[Board]:
    return axes.boards(PROTOCOL, {fusion: Store(folder) for fusion in axes.fusions})


def test_a_star_moves_one_axis_at_a_time_and_a_full_design_all() -> None:
    many = replace(AXES, fusions=("mean", "max"))
    assert many.points == [("mean", 0.3, 2), ("mean", 0.3, 1), ("mean", 0.1, 2), ("max", 0.3, 2)]
    assert len(replace(many, design="full").points) == len(set(replace(many, design="full").points)) == 8


def test_boards_share_what_they_have_in_common(tmp_path: Path) -> None:
    base, fewer, weaker = boards(tmp_path)
    assert {c.attack for c in base.cells} == {"none", "x", "y"} and {c.attack for c in fewer.cells} == {"none", "x"}
    assert {(b.protocol.budget, b.k) for b in (base, fewer, weaker)} == {(0.3, 2), (0.3, 1), (0.1, 2)}
    # 2 defenders × (none, x, y at the base; x at k = 1; none, x at Δ = 0.1): the cells in which nobody lies are one
    assert len(turns_of([base, fewer, weaker])) == 2 * (3 + 1 + 2)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"design": "round"}, "star, full"),
        ({"budgets": (0.1, 0.1)}, "budgets must be"),
        ({"side_attacks": ("q",)}, "q"),
    ],
)
def test_axes_that_make_no_sense_are_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(AXES, **change)  # type: ignore[arg-type]


def made(board: Board, damage: float) -> dict[Cell, tuple[Record, ...]]:
    """As if the board had been played: each attack does the damage in every frame, y half as much again."""
    return {
        cell: tuple(
            record(s, "1", 1, damage=(0.0, (1.5 if cell.attack == "y" else 1.0) * damage * (cell.attack != "none")))
            for s in cell.names
        )
        for cell in board.cells
    }


def test_curves_compare_the_attacks_and_scenes_that_every_point_has(tmp_path: Path) -> None:
    played = list(zip(boards(tmp_path), ({}, {}, {}), strict=True))
    played = [(board, made(board, damage)) for (board, _), damage in zip(played, (0.4, 0.2, 0.1), strict=True)]
    along_k, along_delta = curves(played)
    assert (along_k.axis, along_k.values, along_delta.axis, along_delta.values) == ("k", (1, 2), "budget", (0.1, 0.3))
    assert along_k.attacks == ("x",) and along_k.n_scenes == 2  # y is at the base only
    assert [figure.mean for figure in along_k.damage["d"]] == pytest.approx([0.2, 0.4])
    assert [figure.mean for figure in along_delta.damage["e"]] == pytest.approx([0.1, 0.4])


def test_only_scenes_that_every_pair_has_played_are_compared(tmp_path: Path) -> None:
    base, *_ = boards(tmp_path)
    played = made(base, 0.4)
    cell = next(cell for cell in played if (cell.defender, cell.attack) == ("d", "x"))
    played[cell] = played[cell][:1]
    table = damages(base, played)
    assert all(set(scenes) == {"toy-0"} for by in table.values() for scenes in by.values())
    assert precisions(base, played)["d"]["x"] == {"toy-0": 1.0}
    assert "none" not in table["d"]  # nobody lies there: it is no attack
