"""Certified recall: by hand, and against every attack on small votes."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from cp_env.metrics.certified import certified_recall, is_certified, witnesses
from tests.helpers.roads import boxes_at

CARS = boxes_at((0, 0), (10, 0), (20, 0))


def test_witnesses_by_hand() -> None:
    views = [CARS[:1], CARS[:2], CARS[[0, 2]], boxes_at()]
    assert witnesses(views, CARS).tolist() == [3, 1, 1]
    assert witnesses(views, CARS[:0]).shape == (0,)


def test_the_share_with_enough_witnesses() -> None:
    counts = [0, 1, 2, 3, 4, 5]
    assert certified_recall(counts, 0) == pytest.approx(5 / 6)
    assert certified_recall(counts, 1) == pytest.approx(3 / 6)
    assert certified_recall(counts, 2) == pytest.approx(1 / 6)
    assert certified_recall([], 2) == 1.0
    assert is_certified(np.array([0, 3, 2]), 1).tolist() == [False, True, False]
    with pytest.raises(ValueError, match="at least 0"):
        certified_recall(counts, -1)


@pytest.mark.parametrize("n", [3, 5, 6])
@pytest.mark.parametrize("k", [1, 2])
def test_no_k_attackers_hide_what_is_certified_and_some_hide_the_rest(n: int, k: int) -> None:
    """A vehicle with r witnesses is output by a vote of k + 1 if no choice of k views that fall silent hides it."""
    for r in range(n + 1):
        saw = np.arange(n) < r
        hidden = any(np.delete(saw, list(silent)).sum() < k + 1 for silent in combinations(range(n), k))
        assert hidden == (certified_recall([r], k) == 0.0)
