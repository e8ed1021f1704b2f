"""Rows of the summary against values worked out by hand; records survive the disk."""

from __future__ import annotations

import pytest

from tests.helpers.toy_evaluation import record, rows_of


def test_values_by_hand() -> None:
    episodes = [
        record("a", "11", 2),
        record("a", "0", 2, suspects=(1, 2, 3), converged=2, verifications=(9, 4, 2), damage=(1.0, 1.0, 0.0)),
        record("b", "10", 4, suspects=(), converged=1, verifications=(0, 0, 0)),
    ]
    row = rows_of(prbi__pgd=episodes)["prbi__pgd"]
    # pooled, best first: 1, 0 and 1 of equal score 0.9 (precision 2/3 there), then 1 and 0 at 0.1: 3 of 8 found at 3/5
    assert row.ap50.mean == pytest.approx(2 / 8 * 2 / 3 + 1 / 8 * 3 / 5)
    assert row.ap70 == row.ap50
    assert row.n_scenes == 2
    assert row.n_episodes == 3
    assert row.damage.mean == pytest.approx(((0.75 + 2.0) / 2 + 0.75) / 2 / 3)  # scenes count alike
    assert row.verifications.mean == pytest.approx(((1 + 3) / 2 + 0) / 2)  # the grace frame's 9 are left out
    assert row.verifications_max == 9
    assert row.verifications_alarmed is not None
    assert row.verifications_alarmed.mean == pytest.approx((2 + 3) / 2)
    assert row.alarm_rate.mean == pytest.approx(((0.5 + 1) / 2 + 0) / 2)
    assert row.convergence_rate.mean == pytest.approx((0.5 + 1) / 2)
    assert row.frames_to_convergence is not None
    assert row.frames_to_convergence.mean == pytest.approx((2 + 1) / 2)
    assert row.id_rate is not None
    assert row.id_rate.mean == pytest.approx(((0.5 + 1) / 2 + 0) / 2)
    assert row.mc_rate.mean == pytest.approx(((0 + 1 / 3) / 2 + 0) / 2)
    assert row.frames_per_second == pytest.approx(9 / 1.5)
    assert row.recovery50 is None


def test_ap_recovery_is_the_share_of_the_lost_ap_that_is_restored() -> None:
    rows = rows_of(
        none__none=[record("a", "1111", 4, attackers=()), record("b", "1111", 4, attackers=())],
        none__pgd=[record("a", "10", 4), record("b", "10", 4)],
        prbi__pgd=[record("a", "111", 4), record("b", "111", 4)],
    )
    recovered = rows["prbi__pgd"].recovery50
    assert recovered is not None
    assert recovered.mean == pytest.approx((0.75 - 0.25) / (1 - 0.25))
    assert recovered.low <= recovered.mean <= recovered.high
    undefended = rows["none__pgd"].recovery50
    assert undefended is not None
    assert undefended.mean == 0
    assert rows["none__none"].recovery50 is None
    assert rows["none__none"].id_rate is None


def test_intervals_grow_with_the_spread_between_scenes_and_hold_the_mean() -> None:
    alike = rows_of(prbi__pgd=[record(f"{i}", "10", 2) for i in range(6)])["prbi__pgd"]
    unlike = rows_of(prbi__pgd=[record(f"{i}", "11" if i % 2 else "00", 2) for i in range(6)])["prbi__pgd"]
    assert alike.ap50.high - alike.ap50.low < 1e-9 < unlike.ap50.high - unlike.ap50.low
    assert unlike.ap50.low <= unlike.ap50.mean <= unlike.ap50.high
