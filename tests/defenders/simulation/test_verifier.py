"""Similarities of a simulated verifier: exact, with error rates, and as measured."""

from __future__ import annotations

import numpy as np
import pytest

from defenders.simulation.verifier import ErrorRates, Measured
from defenders.simulation.world import SimulatedWorld
from tests.defenders.simulation.test_world import ATTACKERS, Survey, survey


def test_error_rates_by_size_and_number_of_attackers() -> None:
    """Of the groups of three one is benign, six hold one attacker and three hold two."""
    rates = ErrorRates(
        false_fail={(3, 0): 0.1, (5, 0): 0.0}, false_pass=lambda size, attackers: [0, 0.3, 0.05][attackers]
    )
    rows = survey(SimulatedWorld(5, ATTACKERS, similarity_model=rates, rng=np.random.default_rng(1)), 600)
    attackers = np.array([len(group & ATTACKERS) for group in Survey.groups])
    assert set(np.unique(rows)) == {0.0, 1.0}
    for count, expected, tolerance in ((0, 0.9, 0.04), (1, 0.3, 0.03), (2, 0.05, 0.02)):
        assert rows[:, attackers == count].mean() == pytest.approx(expected, abs=tolerance)


def test_similarities_are_drawn_from_what_was_measured() -> None:
    samples = {(3, 0): [0.7, 0.9], (3, 1): [0.1, 0.2, 0.3], (3, 2): [0.0], (5, 0): [0.8], (5, 2): [0.05]}
    rows = survey(SimulatedWorld(5, ATTACKERS, similarity_model=Measured(samples)), 300)
    for column, group in enumerate(Survey.groups):
        values = samples[3, len(group & ATTACKERS)]
        assert set(rows[:, column]) == set(values)
        assert rows[:, column].mean() == pytest.approx(np.mean(values), abs=0.02)
