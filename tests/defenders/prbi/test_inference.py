"""Eqs. (8)-(14) against numbers worked by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from defenders.prbi.inference import (
    benign_ratio,
    check_options,
    estimate_attackers,
    posterior,
    round_attackers,
    settled,
    upper_quantile,
)


def counts(*values: int) -> np.ndarray:
    return np.array(values, dtype=np.int64)


@pytest.mark.parametrize(
    ("normal", "total", "eta", "m"),
    [
        ((0, 0, 0, 0, 1), 1, 0.2, math.log2(5)),
        ((1, 1, 1, 1, 0), 1, 0.8, math.log2(1.25)),
        ((2, 2, 1, 0, 0), 2, 0.5, 1.0),
        ((0, 0, 0, 0, 0), 3, 0.0, 4.0),  # nothing was normal: the cap n - 1
        ((0, 0, 0, 0, 1), 7, 1 / 35, 4.0),  # log2(35) = 5.1 is above the cap
    ],
)
def test_how_many(normal: tuple[int, ...], total: int, eta: float, m: float) -> None:
    beta, n = counts(*normal), np.full(5, total)
    assert benign_ratio(beta, n) == pytest.approx(eta)
    assert estimate_attackers(beta, n) == pytest.approx(m)


@st.composite
def histories(draw: st.DrawFn) -> tuple[int, int, int]:
    """n vehicles, N validations, Σβ normal ones, such that 1 <= m <= n - 1 without the cap."""
    n, total = draw(st.integers(2, 40)), draw(st.integers(1, 500))
    return n, total, draw(st.integers(max(math.ceil(n * total / 2 ** (n - 1)), 1), n * total // 2))


def spread(n: int, normal: int) -> np.ndarray:
    return np.full(n, normal // n) + (np.arange(n) < normal % n)


@given(histories())
def test_theorem_1_part_1(history: tuple[int, int, int]) -> None:
    """Eq. (15): when no group passes, m grows (to the cap)."""
    n, total, normal = history
    m = estimate_attackers(spread(n, normal), np.full(n, total))
    later = estimate_attackers(spread(n, normal), np.full(n, total + 1))
    assert m < later or later == n - 1


@given(histories())
def test_theorem_1_part_2(history: tuple[int, int, int]) -> None:
    """Eqs. (16)-(22): when the n - ⌊m⌋ least suspicious pass, m shrinks; with two vehicles it stays at 1."""
    n, total, normal = history
    m = estimate_attackers(spread(n, normal), np.full(n, total))
    later = estimate_attackers(spread(n, normal + n - math.floor(m)), np.full(n, total + 1))
    assert later < m or (n == 2 and later == m == 1)


def test_posterior_of_the_first_frame() -> None:
    """n = 5: four passed together, vehicle 4 failed alone. P(A|B) = 1/4, P(A) = 1/5, prior = 0.65."""
    result = posterior(np.zeros(5), counts(1, 1, 1, 1, 0), np.ones(5, dtype=int), gamma=0.35, lam=0.65)
    assert result == pytest.approx([0.8125] * 4 + [0])
    assert result[4] == 0


def test_posterior_remembers_the_last_one() -> None:
    """A frame later everyone failed: P(A|B) = (6-1)/(10-2), P(A) = 6/10, prior = 0.35 · 0.8125 + 0.65 / 2."""
    last = np.array([0.8125] * 4 + [0])
    result = posterior(last, counts(1, 1, 1, 1, 0), np.full(5, 2), gamma=0.35, lam=0.65)
    assert result == pytest.approx([0.634765625] * 4 + [0])


def test_posterior_with_counts_of_their_own() -> None:
    """n = 2, N = (2, 1), β = (1, 0): P(A|B_0) = (2-1)/(3-2) = 1, P(A) = 2/3, prior = 0.65 / 2."""
    result = posterior(np.zeros(2), counts(1, 0), counts(2, 1), gamma=0.35, lam=0.65)
    assert result == pytest.approx([0.325 * 1.5, 0])


def test_posterior_without_any_abnormal_detection_is_the_prior() -> None:
    result = posterior(np.array([0.2, 0.0]), counts(3, 3), counts(3, 3), gamma=0.35, lam=0.65)
    assert result == pytest.approx([0.72, 0.65])


@given(st.integers(2, 12), st.integers(1, 20), st.randoms(use_true_random=False))
def test_never_normal_means_probability_zero_and_stays_so(n: int, rounds: int, random: object) -> None:
    rng = np.random.default_rng(random.getrandbits(32))  # type: ignore[attr-defined]
    probability, normal = np.zeros(n), np.zeros(n, dtype=int)
    for total in range(1, rounds + 1):
        normal += rng.integers(0, 2, n) * (np.arange(n) > 0)
        probability = posterior(probability, normal, np.full(n, total), gamma=0.35, lam=0.65)
        assert np.isfinite(probability).all() and (probability >= 0).all()
        assert (probability[normal == 0] == 0).all()


@pytest.mark.parametrize(
    ("m", "floor", "nearest", "ceiling"), [(0.32, 0, 0, 1), (2.5, 2, 3, 3), (3.0, 3, 3, 3), (1.74, 1, 2, 2)]
)
def test_rounding(m: float, floor: int, nearest: int, ceiling: int) -> None:
    assert [round_attackers(m, how) for how in ("floor", "nearest", "ceiling")] == [floor, nearest, ceiling]


@pytest.mark.parametrize(
    ("alpha", "freedom", "value"), [(0.01, 1, 63.657), (0.01, 9, 3.250), (0.2, 3, 1.638), (0.05, 4, 2.776)]
)
def test_quantiles_of_the_printed_table(alpha: float, freedom: int, value: float) -> None:
    assert upper_quantile(alpha, freedom) == pytest.approx(value, abs=5e-4)


@pytest.mark.parametrize(
    ("window", "m", "alpha", "verdict"),
    [
        ([2.0], 2.0, 0.01, False),  # one sample
        ([2.0, 4.0], 4.0, 0.01, True),  # mean 3, S/√2 = 1, t = 1 < 63.7
        ([3.0, 3.0, 3.0, 3.1], 4.0, 0.01, False),  # mean 3.025, S/√4 = 0.025, t = 39 > 5.84
        ([3.0, 3.0, 3.0, 3.1], 3.1, 0.01, True),  # t = 3
        ([3.0, 3.0, 3.0, 3.1], 3.1, 0.2, False),  # t = 3 > 1.64
        ([2.0, 2.0], 2.0, 0.01, True),  # S = 0
        ([2.0, 2.0], 2.1, 0.01, False),
    ],
)
def test_t_test(window: list[float], m: float, alpha: float, verdict: bool) -> None:
    assert settled(window, m, alpha) is verdict


@pytest.mark.parametrize(
    "option", [{"window": 1}, {"alpha": 0.0}, {"alpha": 1.0}, {"gamma": -0.1}, {"lam": 0.0}, {"lam": float("nan")}]
)
def test_options_out_of_range_are_refused(option: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(option))):
        check_options(**{"window": 10, "alpha": 0.01, "gamma": 0.35, "lam": 0.65, **option})  # type: ignore[arg-type]
