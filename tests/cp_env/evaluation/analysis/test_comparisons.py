"""Paired differences and Holm's correction: worked by hand, by SciPy, and their laws."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from cp_env.evaluation.analysis.comparisons import compare, holm, paired_difference
from tests.helpers.skewed_samples import SHARES


def test_holm_worked_by_hand() -> None:
    """0.01 × 4, then 0.015 × 3 = 0.045, 0.03 × 2 = 0.06, and 0.035 × 1, which may not fall below the one before."""
    assert holm([0.035, 0.01, 0.03, 0.015]) == pytest.approx([0.06, 0.04, 0.06, 0.045])
    assert holm([0.5, 0.6]) == pytest.approx([1, 1]), "no probability is above 1"
    assert holm([0.03]) == pytest.approx([0.03]) and holm([]).size == 0


def test_holm_between_no_correction_and_bonferronis() -> None:
    rng = np.random.default_rng(0)
    for m in (2, 7, 28):
        p = rng.random(m) ** 3
        adjusted = holm(p)
        assert (p <= adjusted).all() and (adjusted <= np.minimum(m * p, 1) + 1e-12).all()
        assert adjusted.min() == pytest.approx(min(1, m * p.min())), "the least is Bonferroni's"
        assert (np.diff(adjusted[np.argsort(p)]) >= 0).all(), "the order stays"
        assert (adjusted >= stats.false_discovery_control(p) - 1e-12).all(), "stricter than Benjamini and Hochberg"


def test_a_pair_is_tested_as_scipy_does() -> None:
    rng = np.random.default_rng(1)
    a, b = rng.random(9), rng.random(9)
    interval, p = paired_difference(a, b)
    theirs = stats.ttest_rel(a, b)
    limits = theirs.confidence_interval()
    assert p == pytest.approx(theirs.pvalue)
    assert (interval.low, interval.high) == pytest.approx((limits.low, limits.high))


def test_a_constant_shift_is_a_difference_without_width() -> None:
    """Scenes may differ as they like: what both entries share drops out."""
    hard = np.array([0.1, 0.7, 0.3, 0.2, 0.9, 0.4, 0.6])
    interval, p = paired_difference(hard, hard - 0.05)
    assert (interval.mean, interval.low, interval.high) == pytest.approx((0.05, 0.05, 0.05)) and p == 0.0
    same, p = paired_difference(hard, hard)
    assert (same.low, same.high, p) == (0.0, 0.0, 1.0)


def test_pairing_laws() -> None:
    rng = np.random.default_rng(2)
    a, b, scene = rng.random(8), rng.random(8), 5 * rng.random(8)
    interval, p = paired_difference(a, b)
    turned, turned_p = paired_difference(b, a)
    assert (turned.mean, turned.low, turned.high) == pytest.approx((-interval.mean, -interval.high, -interval.low))
    harder, harder_p = paired_difference(a + scene, b + scene)
    assert (harder.low, harder.high, harder_p) == pytest.approx((interval.low, interval.high, p))
    order = rng.permutation(8)
    shuffled, _ = paired_difference(a[order], b[order])
    assert (shuffled.low, shuffled.high, turned_p) == pytest.approx((interval.low, interval.high, p))


def test_few_scenes_separate_nobody() -> None:
    for n in range(1, 6):
        (pair,) = compare({"x": {str(i): 0.9 for i in range(n)}, "y": {str(i): 0.1 for i in range(n)}})
        assert not pair.told_apart and pair.adjusted == 1.0 and pair.interval.mean == pytest.approx(0.8)
    (pair,) = compare({"x": {str(i): 0.9 for i in range(6)}, "y": {str(i): 0.1 for i in range(6)}})
    assert pair.told_apart


@pytest.mark.parametrize("n", [6, 9, 21])
def test_entries_that_are_alike_are_rarely_told_apart(n: int) -> None:
    """At most 5 % of the tables of 28 pairs hold even one false verdict; without Holm's correction most do."""
    family, rng = SHARES["near 0.1 or 0.9, 4 in 10 high"], np.random.default_rng(n)
    wrong = uncorrected = 0
    for _ in range(100):
        drawn = family.draw(rng, (8, n))
        pairs = compare({str(i): dict(zip("abcdefghijklmnopqrstu", row.tolist())) for i, row in enumerate(drawn)})  # noqa: B905
        wrong += any(pair.told_apart for pair in pairs)
        uncorrected += any(pair.p < 0.05 for pair in pairs)
    assert wrong <= 11 < 25 < uncorrected  # 3 standard errors above 5


def test_every_pair_once_in_the_order_of_the_entries() -> None:
    values = {name: {"s": float(i), "t": float(i)} for i, name in enumerate("abc")}
    assert [(pair.first, pair.second) for pair in compare(values)] == [("a", "b"), ("a", "c"), ("b", "c")]


def test_bad_input_is_refused() -> None:
    with pytest.raises(ValueError, match="same scenes of both; got 2 and 3"):
        paired_difference([0.1, 0.2], [0.1, 0.2, 0.3])
    with pytest.raises(ValueError, match="'x' and 'y' have not played the same scenes"):
        compare({"x": {"a": 0.1}, "y": {"b": 0.1}})
    with pytest.raises(ValueError, match=r"p-values lie in \[0, 1\]"):
        holm([0.2, 1.2])
