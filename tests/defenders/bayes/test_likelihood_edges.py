"""Outliers and discrimination, against their definitions."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from defenders.bayes.likelihood import Verifier
from tests.helpers.densities import made_up


@pytest.mark.parametrize(("false_fail", "false_pass"), [(1e-3, 1e-3), (0.1, 0.2), (0.49, 0.49)])
def test_discrimination_is_the_total_variation(false_fail: float, false_pass: float) -> None:
    """Of a binary verifier: 1 less both rates of error, so that 1 is certainty."""
    assert Verifier(false_fail, false_pass).discrimination(1) == pytest.approx(1 - false_fail - false_pass)


@pytest.mark.parametrize("seed", range(5))
def test_an_outlier_is_the_mean_over_attackers_drawn_anew(seed: int) -> None:
    """Two groups of a fleet of `most` share at least as many vehicles as do not fit apart."""
    likelihood = made_up(seed)
    for size, other, mode in product(range(1, 4), range(1, 4), (1, 2)):
        common = [shared for shared in range(4) if size + other - 3 <= shared <= min(size, other)]
        kinds = (
            [likelihood.uncontaminated(size, other, shared, 1) for shared in common],
            [likelihood.one_contaminated(size, attackers, other, mode) for attackers in range(1, size + 1)],
            [likelihood.one_contaminated(other, attackers, size, mode) for attackers in range(1, other + 1)],
            [likelihood.both_contaminated(size, other, mode, mode)],
        )
        expected = sum(np.mean(rows, axis=0) for rows in kinds) / 4
        assert likelihood.outlier(size, other, mode) == pytest.approx(expected)
