"""A move of a particle changes one vehicle, or exchanges two: then as many attack as before."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from defenders.bayes.particles import moved


@given(st.integers(1, 12), st.integers(0, 10**6))
def test_one_vehicle_changes_or_two_are_exchanged(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    sets = rng.random((50, n)) < 0.5
    before = sets.copy()
    proposed = moved(sets, rng)
    changed, growth = (proposed != sets).sum(1), proposed.sum(1) - sets.sum(1)
    assert set(changed.tolist()) <= {1, 2}
    assert (abs(growth[changed == 1]) == 1).all() and (growth[changed == 2] == 0).all()
    assert (sets == before).all()


@pytest.mark.parametrize("k", [1, 5, 9])
def test_both_kinds_of_move_are_made_and_every_vehicle_is_moved(k: int) -> None:
    """Two of ten that differ are drawn with probability 2 k (10 - k) / 100, and half of them are exchanged."""
    sets = np.tile(np.arange(10) < k, (4000, 1))
    changed = moved(sets, np.random.default_rng(0)) != sets
    assert (changed.sum(1) == 2).mean() == pytest.approx(k * (10 - k) / 100, abs=0.03)
    assert changed.any(0).all()
