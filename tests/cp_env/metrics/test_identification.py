"""Identification rates and AP recovery, worked by hand."""

from __future__ import annotations

import pytest

from cp_env.metrics.identification import id_rate, mc_rate, recovery


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
