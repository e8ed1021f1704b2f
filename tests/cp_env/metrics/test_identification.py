"""Identification rates and AP recovery, worked by hand."""

from __future__ import annotations

import numpy as np
import pytest

from cp_env.metrics.identification import id_rate, mc_rate, recovery, roc


def test_identification_worked_by_hand() -> None:
    assert id_rate({1, 2, 3}, {2, 4}) == 0.5
    assert mc_rate({1, 2, 3}, {2, 4}, n=6) == 2 / 4
    assert id_rate(frozenset(), {0}) == mc_rate((), {0}, n=5) == 0
    assert id_rate({0}, ()) == 1  # no attacker: all of none are found
    assert mc_rate({0}, {0, 1}, n=2) == 0  # nobody is benign


def test_recovery_worked_by_hand() -> None:
    assert recovery(0.7, attacked=0.4, clean=0.8) == pytest.approx(0.75)
    assert recovery(0.8, 0.4, 0.8) == 1
    assert recovery(0.2, 0.4, 0.8) == pytest.approx(-0.5)
    assert recovery(0.9, 0.4, 0.8) == pytest.approx(1.25)
    assert recovery(0.8, 0.8, 0.8) == 1  # nothing was lost, nothing is missing
    assert recovery(0.7, 0.8, 0.8) == 0


def test_the_roc_by_hand() -> None:
    """Thresholds ∞, 0.9, 0.6, 0.2, 0 flag none, then one of two attackers, both and one of four benign, …"""
    curve = roc(benign=[0.0, 0.0, 0.2, 0.6], malicious=[0.6, 0.9])
    assert curve.threshold.tolist() == [np.inf, 0.9, 0.6, 0.2, 0.0]
    assert curve.fpr.tolist() == [0, 0, 0.25, 0.5, 1]
    assert curve.tpr.tolist() == [0, 0.5, 1, 1, 1]
    assert curve.tpr_at(0.03) == 0.5
    assert curve.tpr_at(0.25) == 1.0


def test_the_area_is_the_chance_to_outscore_a_benign_vehicle() -> None:
    """Ties count half; every pair is compared here one by one."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        benign, malicious = rng.integers(0, 6, 30), rng.integers(1, 8, 20)
        wins = np.sign(malicious[:, None] - benign)
        assert roc(benign, malicious).auc == pytest.approx(float((wins + 1).mean() / 2))


def test_equal_scores_have_half_the_area_and_flag_nobody_at_a_low_rate() -> None:
    curve = roc([0.5] * 10, [0.5] * 3)
    assert curve.auc == 0.5
    assert curve.tpr_at(0.03) == 0.0


@pytest.mark.parametrize(("benign", "malicious"), [([], [1.0]), ([1.0], []), ([np.nan], [1.0])])
def test_scores_that_make_no_roc(benign: list[float], malicious: list[float]) -> None:
    with pytest.raises(ValueError, match="scores"):
        roc(benign, malicious)
