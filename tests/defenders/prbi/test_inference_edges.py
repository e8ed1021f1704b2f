"""The stopping test at its limits, Eq. (14): |W̄ - m| √w / S is at most t, with S over w - 1 degrees of freedom."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from defenders.prbi.inference import settled, upper_quantile


@given(
    st.lists(st.floats(0, 10), min_size=2, max_size=10), st.sampled_from([0.01, 0.05, 0.5]), st.sampled_from([-1, 1])
)
def test_the_window_settles_m_up_to_the_quantile_and_no_further(values: list[float], alpha: float, side: int) -> None:
    n = len(values)
    mean = sum(values) / n
    deviation = math.sqrt(sum((value - mean) ** 2 for value in values) / (n - 1))
    if deviation < 1e-3:
        return
    reach = upper_quantile(alpha, n - 1) * deviation / math.sqrt(n)
    assert settled(values, mean + side * reach * 0.999, alpha)
    assert not settled(values, mean + side * reach * 1.001, alpha)


@pytest.mark.parametrize("window", [[], [1.0]])
def test_fewer_than_two_values_settle_nothing(window: list[float]) -> None:
    assert not settled(window, 1.0, 0.01)
