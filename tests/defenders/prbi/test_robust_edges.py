"""The groups of the corrected rule: whatever m is, the second holds an open vehicle, so any frame may settle one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from defenders.prbi import RobustPrbi


@given(st.integers(2, 8), st.data())
def test_the_second_group_holds_an_open_vehicle_and_all_cleared_ones(n: int, data: st.DataObject) -> None:
    kinds = data.draw(st.lists(st.sampled_from(["open", "cleared", "convicted"]), min_size=n, max_size=n))
    cleared, convicted, unsure = (
        frozenset(i for i, kind in enumerate(kinds) if kind == name) for name in ("cleared", "convicted", "open")
    )
    if not unsure:
        return
    defender = RobustPrbi()
    defender.reset(n, np.random.default_rng(data.draw(st.integers(0, 100))))
    defender.group_test.cleared = cleared
    defender.group_test.failed = {frozenset({i}) for i in convicted}
    defender.m = data.draw(st.floats(0, n - 1))
    groups = defender._soft_sampling()
    assert groups[-1] & unsure and groups[-1] >= cleared
    assert frozenset().union(*groups) == cleared | unsure
    assert sum(map(len, groups)) == len(cleared | unsure), "no vehicle is in two groups"
    if len(groups) == 2:
        assert len(groups[0]) == min(max(int(defender.m) - len(convicted), 0), len(unsure) - 1)


@pytest.mark.parametrize("n", [2, 5, 8])
def test_nothing_known_and_m_at_its_cap_leaves_one(n: int) -> None:
    defender = RobustPrbi()
    defender.reset(n, np.random.default_rng(0))
    assert [len(group) for group in defender._soft_sampling()] == [n - 1, 1]
