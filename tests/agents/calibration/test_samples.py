"""Errors and thresholds of samples, worked by hand."""

from __future__ import annotations

import numpy as np
import pytest

from agents.calibration.samples import Samples, best_threshold, errors, no_samples, pooled


@pytest.fixture
def samples() -> Samples:
    """Groups of two: four benign ones in two scenes, with one attacker, and with two."""
    found = no_samples()
    found[2, 0]["a"], found[2, 0]["b"] = [0.5, 0.6], [0.7, 0.8]
    found[2, 1]["a"], found[2, 2]["b"] = [0.1, 0.9], [0.2, 0.3, 0.1, 0.1]
    return found


def test_scores_are_pooled_over_scenes(samples: Samples) -> None:
    assert pooled(samples, (2, 0)).tolist() == [0.5, 0.6, 0.7, 0.8]


def test_errors_by_hand(samples: Samples) -> None:
    """Two attackers count as much as one, however many samples there are of each."""
    assert errors(samples, 2, 0.4, strict=True) == (0.0, 0.25)
    assert errors(samples, 2, 0.65, strict=True) == (0.5, 0.25)
    assert errors(samples, 2, 0.5, strict=False) == (0.0, 0.25)
    assert errors(samples, 2, 0.5, strict=True) == (0.25, 0.25), "a group at ε does not pass"


@pytest.mark.parametrize("strict", [False, True])
def test_the_threshold_errs_least(samples: Samples, strict: bool) -> None:
    """Against every value of the grid, and in the middle of those that err as little."""
    grid = np.linspace(0.0, 1.0, 41)
    epsilon = best_threshold(samples, 2, grid, strict=strict, digits=6)
    least = min(sum(errors(samples, 2, float(e), strict=strict)) for e in grid)
    assert sum(errors(samples, 2, epsilon, strict=strict)) == pytest.approx(least)
    assert 0.3 <= epsilon <= 0.5 and epsilon == pytest.approx(0.4, abs=0.02)
