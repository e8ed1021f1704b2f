"""95 % confidence intervals by hand, by coverage, by SciPy and by seed."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest
from scipy import stats

from cp_env.metrics.intervals import Interval, bootstrap_interval, jackknife_interval, rate_interval, t_interval
from tests.helpers.skewed_samples import COUNTS


def test_t_interval_worked_by_hand() -> None:
    """1, 2, 3: mean 2, standard deviation 1, quantile of two degrees of freedom 4.30265."""
    interval = t_interval([1, 2, 3])
    reach = 4.30265 / math.sqrt(3)
    assert (interval.mean, interval.n) == (2, 3)
    assert interval.low == pytest.approx(2 - reach, abs=1e-5)
    assert interval.high == pytest.approx(2 + reach, abs=1e-5)
    narrow = t_interval([1, 2, 3], confidence=0.5)
    assert narrow.high == pytest.approx(2 + 0.81650 / math.sqrt(3), abs=1e-5)
    assert t_interval([1, 2, 3], least=0.0).low == 0.0, "no count is below 0"
    assert t_interval([1, 2, 3], least=0.0).high == interval.high


def test_a_single_value_has_no_spread_and_no_nan() -> None:
    assert t_interval([0.4]) == Interval(0.4, 0.4, 0.4, 1)
    assert bootstrap_interval(lambda rows: 0.4, 1, seed=0) == Interval(0.4, 0.4, 0.4, 1)
    assert jackknife_interval(lambda rows: 0.4, 1) == Interval(0.4, 0.4, 0.4, 1)


def test_how_it_reads() -> None:
    assert str(Interval(0.8123, 0.7901, 0.8333, 20)) == "0.812 [0.790, 0.833]"
    assert f"{Interval(0.8123, 0.7901, 0.8333, 20):.1f}" == "0.8 [0.8, 0.8]"
    assert str(Interval(0.8123, 0.8123, 0.8123, 1)) == "0.812 (n=1)"
    assert f"{rate_interval(0, 9):.2f}" == "0 of 9 [0.00, 0.34]"
    assert str(rate_interval(1, 1)) == "1 of 1"


# ── rates ────────────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize(
    ("hits", "n", "low", "high"),
    [
        (0, 9, 0.0, 0.33627),
        (9, 9, 0.66373, 1.0),
        (1, 10, 0.00253, 0.44502),
        (81, 263, 0.2527, 0.3676),  # R. Newcombe, Statistics in Medicine 17 (1998), table I, method 5
        (15, 148, 0.0578, 0.1617),
        (0, 20, 0.0, 0.1684),
        (1, 29, 0.0009, 0.1776),
    ],
)
def test_bounds_of_clopper_and_pearson_as_published(hits: int, n: int, low: float, high: float) -> None:
    interval = rate_interval(hits, n)
    assert (interval.mean, interval.n, interval.hits) == (hits / n, n, hits)
    assert (interval.low, interval.high) == pytest.approx((low, high), abs=6e-5)


def test_a_rate_is_what_its_tails_say() -> None:
    """The limits by their definition: as few hits, or as many, have a probability of 2.5 % there."""
    for hits in range(1, 9):
        interval = rate_interval(hits, 9)
        assert stats.binom.cdf(hits, 9, interval.high) == pytest.approx(0.025)
        assert stats.binom.sf(hits - 1, 9, interval.low) == pytest.approx(0.025)
    assert rate_interval(0, 9).high == pytest.approx(1 - 0.025 ** (1 / 9)), "no event in nine"


def test_a_rate_holds_the_truth_19_times_in_20_whatever_it_is() -> None:
    """Exactly, by summing over all that may happen."""
    for n in (3, 6, 9, 21):
        intervals = [rate_interval(hits, n) for hits in range(n + 1)]
        for truth in np.linspace(0.01, 0.99, 50):
            held = [i.low <= truth <= i.high for i in intervals]
            assert stats.binom.pmf(range(n + 1), n, truth) @ held >= 0.95


# ── means of counts ──────────────────────────────────────────────────────────────────────────────────────────────────


def coverage(family: str, n: int, times: int = 1000) -> float:
    """Share of Student's intervals that hold the mean."""
    drawn = COUNTS[family].draw(np.random.default_rng(n), (times, n))
    found = [t_interval(values) for values in drawn]
    return float(np.mean([i.low <= COUNTS[family].mean <= i.high for i in found]))


@pytest.mark.parametrize("n", [3, 6, 9, 21])
def test_t_interval_covers_the_mean_19_times_in_20(n: int) -> None:
    assert 0.93 < coverage("normal", n) < 0.97  # ±3 standard errors


def test_t_interval_covers_less_where_counts_have_long_tails() -> None:
    """What the page says: nearly as much for moderate skew, about 0.82 for a log-normal of σ = 1 and six values."""
    assert 0.88 < coverage("log-normal, σ = 0.5", 6) < 0.95
    assert 0.91 < coverage("log-normal, σ = 0.5", 21) < 0.96
    assert 0.76 < coverage("log-normal, σ = 1", 6) < 0.88


# ── pooled figures ───────────────────────────────────────────────────────────────────────────────────────────────────


def test_the_jackknife_of_a_mean_is_students_interval() -> None:
    values = np.random.default_rng(3).random(9)
    plain, left_out = t_interval(values), jackknife_interval(lambda rows: float(values[rows].mean()), 9)
    assert (left_out.mean, left_out.low, left_out.high) == pytest.approx((plain.mean, plain.low, plain.high))


def test_the_jackknife_of_a_ratio_by_hand() -> None:
    """Sums 1, 2, 3 over 1, 1, 2: 6/4; without each scene 5/3, 4/3 and 3/2, of which 1/6 is the standard deviation."""
    sums, lengths = np.array([1.0, 2.0, 3.0]), np.array([1.0, 1.0, 2.0])
    interval = jackknife_interval(lambda rows: float(sums[rows].sum() / lengths[rows].sum()), 3)
    assert interval.mean == 1.5
    assert interval.high - 1.5 == pytest.approx(4.30265 * 2 * (1 / 6) / math.sqrt(3), abs=1e-5)


def test_the_bootstrap_is_that_of_scipy() -> None:
    values = np.random.default_rng(0).lognormal(size=30)
    ours = bootstrap_interval(lambda rows: float(values[rows].mean()), 30, seed=4, resamples=500)
    theirs = stats.bootstrap(
        (values,), np.mean, n_resamples=500, method="BCa", random_state=np.random.default_rng(4)
    ).confidence_interval
    assert (ours.low, ours.high) == pytest.approx((theirs.low, theirs.high))
    assert ours.high - ours.mean > ours.mean - ours.low, "the long tail is above"


def test_the_bootstrap_covers_a_ratio_of_a_hundred_episodes_about_19_times_in_20() -> None:
    rng, hits = np.random.default_rng(0), 0
    for k in range(200):
        frames = rng.integers(2, 20, size=100)
        counts = rng.poisson(3.0 * frames)

        def ratio(rows: np.ndarray, counts: np.ndarray = counts, frames: np.ndarray = frames) -> float:
            return float(counts[rows].sum() / frames[rows].sum())

        interval = bootstrap_interval(ratio, 100, seed=k, resamples=199)
        hits += interval.low <= 3.0 <= interval.high
    assert 0.9 < hits / 200 < 0.985


def test_the_bootstrap_of_scenes_that_do_not_differ_has_no_width_and_does_not_warn() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        interval = bootstrap_interval(lambda rows: 0.5, 5, seed=0, resamples=50)
    assert interval == Interval(0.5, 0.5, 0.5, 5)


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

    def mean(rows: np.ndarray) -> float:
        return float(values[rows].mean())

    for wide, narrow in [
        (t_interval(values, confidence=0.99), t_interval(values)),
        (jackknife_interval(mean, 12, confidence=0.99), jackknife_interval(mean, 12)),
        (bootstrap_interval(mean, 12, seed=0, confidence=0.99), bootstrap_interval(mean, 12, seed=0)),
        (rate_interval(3, 12, confidence=0.99), rate_interval(3, 12)),
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
    with pytest.raises(ValueError, match="between 0 and 1; got 95"):
        t_interval([1.0], confidence=95)
    with pytest.raises(ValueError, match="below 0; got -1"):
        t_interval([1.0, -1.0], least=0.0)
    for interval in (jackknife_interval, lambda f, n: bootstrap_interval(f, n, seed=0)):
        with pytest.raises(ValueError, match="n=0"):
            interval(lambda rows: 0.0, 0)
        with pytest.raises(ValueError, match="finite for every resample"):
            interval(lambda rows: math.nan, 3)
    with pytest.raises(ValueError, match="resamples=0"):
        bootstrap_interval(lambda rows: 0.0, 3, seed=0, resamples=0)
    for hits, n in ((1, 0), (-1, 3), (4, 3)):
        with pytest.raises(ValueError, match=f"got {hits} of {n}"):
            rate_interval(hits, n)
