"""Rows of the summary against values worked out by hand; records survive the disk."""

from __future__ import annotations

import numpy as np
import pytest

from cp_env.evaluation.analysis.summary import all_found, nothing_found
from cp_env.evaluation.plan.records import PooledApMeter
from cp_env.metrics.average_precision import resampled_ap
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
    assert (row.convergence_rate.hits, row.convergence_rate.n) == (2, 3)  # episodes count, not scenes
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
    assert 0 < alike.ap50.high - alike.ap50.low < unlike.ap50.high - unlike.ap50.low
    assert unlike.ap50.low <= unlike.ap50.mean <= unlike.ap50.high


def test_every_share_stays_within_0_and_1_and_what_never_happened_has_an_upper_bound() -> None:
    rows = rows_of(prbi__pgd=[record(f"{i}", "11" if i % 2 else "00", 2, suspects=()) for i in range(9)])
    row = rows["prbi__pgd"]
    assert row.id_rate is not None
    for share in (row.ap50, row.ap70, row.damage, row.alarm_rate, row.convergence_rate, row.id_rate, row.mc_rate):
        assert 0 <= share.low <= share.mean <= share.high <= 1 and share.n == 9
    assert f"{row.convergence_rate:.2f}" == "0 of 9 [0.00, 0.34]"
    assert f"{row.mc_rate:.2f}" == "0.00 [0.00, 0.34]", "no bound of nothing from nine scenes"
    assert row.verifications.low >= 0


def test_seeds_of_a_scene_are_one_unit() -> None:
    """The same episode under ten seeds says no more than once."""
    once = [record(s, hits, 2, damage=(0.0, harm, harm)) for s, hits, harm in (("a", "11", 0.2), ("b", "10", 0.6))]
    one, ten = (rows_of(prbi__pgd=of)["prbi__pgd"] for of in (once, 10 * once))
    assert (one.damage, one.verifications) == (ten.damage, ten.verifications)
    assert (one.ap50.low, one.ap50.high) == pytest.approx((ten.ap50.low, ten.ap50.high))
    assert (ten.n_scenes, ten.n_episodes) == (2, 20)


def test_the_two_further_scenes_bound_the_ap() -> None:
    """In one of them everything is found before all else, in the other nothing."""
    pool = [PooledApMeter.pool([record(s, hits, 4).meter]) for s, hits in (("a", "1101"), ("b", "0011"))]
    ap, worst, best = (resampled_ap([*pool, *of], 0.5) for of in ([], [nothing_found(pool)], [all_found(pool)]))
    alone, both = np.array([2]), np.array([0, 1])
    assert (worst(alone), best(alone)) == (0.0, 1.0)
    assert worst(both) == best(both) == ap(both)
    assert worst(np.array([0, 1, 2])) < ap(both) < best(np.array([0, 1, 2]))
    assert nothing_found(pool).n_truth == all_found(pool).n_truth == 4
