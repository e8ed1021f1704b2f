"""What was seen is not asked again, however many groups were seen."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from defenders.bayes.acquisition import unseen


@given(st.integers(1, 5), st.integers(0, 8), st.integers(0, 10**6))
def test_unseen_are_all_groups_but_the_seen_and_the_empty_one(n: int, count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    groups, seen = rng.random((20, n)) < 0.5, rng.random((count, n)) < 0.5
    known = {tuple(group) for group in seen.tolist()} | {(False,) * n}
    expected = [group for group in groups.tolist() if tuple(group) not in known]
    assert unseen(groups, seen).tolist() == expected
