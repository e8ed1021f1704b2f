"""95 % confidence intervals by hand, by coverage and by seed."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cp_env.metrics.intervals import Interval, bootstrap_interval, t_interval


def test_t_interval_worked_by_hand() -> None:
    """1, 2, 3: mean 2, standard deviation 1, quantile of two degrees of freedom 4.30265."""
    interval = t_interval([1, 2, 3])
    reach = 4.30265 / math.sqrt(3)
    assert (interval.mean, interval.n) == (2, 3)
    assert interval.low == pytest.approx(2 - reach, abs=1e-5)
    assert interval.high == pytest.approx(2 + reach, abs=1e-5)
    narrow = t_interval([1, 2, 3], confidence=0.5)
    assert narrow.high == pytest.approx(2 + 0.81650 / math.sqrt(3), abs=1e-5)


def test_a_single_value_has_no_spread_and_no_nan() -> None:
    assert t_interval([0.4]) == Interval(0.4, 0.4, 0.4, 1)
    assert bootstrap_interval(lambda rows: 0.4, 1, seed=0) == Interval(0.4, 0.4, 0.4, 1)


def test_how_it_reads() -> None:
    assert str(Interval(0.8123, 0.7901, 0.8333, 20)) == "0.812 [0.790, 0.833]"
    assert f"{Interval(0.8123, 0.7901, 0.8333, 20):.1f}" == "0.8 [0.8, 0.8]"
    assert str(Interval(0.8123, 0.8123, 0.8123, 1)) == "0.812 (n=1)"


def test_t_interval_covers_the_mean_19_times_in_20() -> None:
    rng = np.random.default_rng(0)
    intervals = [t_interval(rng.normal(3, 2, size=5)) for _ in range(1000)]
    assert 0.93 < np.mean([i.low <= 3 <= i.high for i in intervals]) < 0.97  # ±3 standard errors


def test_bootstrap_covers_the_mean_about_19_times_in_20() -> None:
    """The percentile bootstrap is a little too narrow at 40 scenes: 93 to 94 % of the time."""
    rng = np.random.default_rng(0)
    hits = 0
    for k in range(100):
        values = rng.normal(3, 2, size=40)
        interval = bootstrap_interval(lambda rows, v=values: v[rows].mean(), 40, seed=k, resamples=100)
        hits += interval.low <= 3 <= interval.high
    assert 0.88 < hits / 100 < 0.985


def test_bootstrap_is_seeded() -> None:
    values = np.random.default_rng(1).random(12)

    def statistic(rows: np.ndarray) -> float:
        return float(values[rows].mean())

    first = bootstrap_interval(statistic, 12, seed=0)
    assert first == bootstrap_interval(statistic, 12, seed=0)
    assert first != bootstrap_interval(statistic, 12, seed=1)
    assert first.mean == pytest.approx(values.mean())
    assert first.low < first.mean < first.high


def test_more_confidence_is_wider() -> None:
    values = np.random.default_rng(2).random(12)
    for wide, narrow in [
        (t_interval(values, confidence=0.99), t_interval(values)),
        (
            bootstrap_interval(lambda rows: values[rows].mean(), 12, seed=0, confidence=0.99),
            bootstrap_interval(lambda rows: values[rows].mean(), 12, seed=0),
        ),
    ]:
        assert wide.low < narrow.low < narrow.high < wide.high


def test_equal_values_have_no_width() -> None:
    interval = t_interval([0.5, 0.5, 0.5])
    assert (interval.low, interval.high) == (0.5, 0.5)


def test_bad_input_is_refused() -> None:
    with pytest.raises(ValueError, match="at least one value"):
        t_interval([])
    with pytest.raises(ValueError, match="finite; got nan"):
        t_interval([1.0, math.nan])
    with pytest.raises(ValueError, match="between 0 and 1; got 95"):
        t_interval([1.0, 2.0], confidence=95)
    with pytest.raises(ValueError, match="n=0"):
        bootstrap_interval(lambda rows: 0.0, 0, seed=0)
    with pytest.raises(ValueError, match="resamples=0"):
        bootstrap_interval(lambda rows: 0.0, 3, seed=0, resamples=0)
    with pytest.raises(ValueError, match="finite for every resample"):
        bootstrap_interval(lambda rows: math.nan, 3, seed=0, resamples=5)
