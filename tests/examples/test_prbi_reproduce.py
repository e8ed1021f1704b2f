"""The programs that reproduce the paper's tables and figures: what they compute, on small runs."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cp_env.evaluation import Record
from cp_env.metrics.average_precision import ApMeter
from examples.reproduce import prbi_fleets, prbi_parameters, prbi_probability, prbi_rounding, prbi_stopping


def record(verifications: tuple[int, ...], converged: int | None) -> Record:
    zeros = tuple(0.0 for _ in verifications)
    return Record(
        scene="s",
        attackers=(1, 2),
        n_maps=5,
        grace_frames=1,
        meter=ApMeter((0.5, 0.7)),
        damage=zeros,
        similarity=zeros,
        verifications=verifications,
        suspects=(1, 2, 3),
        converged=converged,
        error=None,
        seconds=0.0,
    )


def test_a_run_on_the_detector_ends_with_convergence() -> None:
    run = prbi_parameters.as_run(record((0, 4, 2, 2, 0, 0), converged=3))
    assert run == prbi_parameters.Run([4, 2, 2], True, 1.0, 1 / 3)
    assert prbi_parameters.as_run(record((0, 4, 2), converged=None)).counts == [4, 2]


def test_a_row_of_tables_4_and_5() -> None:
    runs = [prbi_parameters.Run([4, 2, 2], True, 1.0, 0.5), prbi_parameters.Run([2] * 5, False, 0.0, 0.0)]
    row = prbi_parameters.summarise(2, 0.2, 10, runs)
    assert (row.least, row.most, row.unsettled.mean) == (2, 4, 0.5)
    assert (row.unsettled.low, row.unsettled.high) == pytest.approx((0.0126, 0.9874), abs=1e-4)  # 1 of 2, exactly
    assert (row.low.mean, row.high.mean, row.mean.mean, row.frames.mean) == (2, 3, 18 / 8, 4)
    assert row.identified is not None and row.false_accusation_rate is not None
    assert (row.identified.mean, row.false_accusation_rate.mean) == (100, 50)  # of those that converged
    assert prbi_parameters.summarise(2, 0.2, 10, runs[1:]).identified is None


def test_the_papers_rows_agree_where_its_tables_repeat_themselves() -> None:
    """α = 0.01 and w = 10 is a row of both halves."""
    for k in (1, 2, 3, 4):
        assert prbi_parameters.published(k, 4) == prbi_parameters.published(k, 5)


def test_limits_of_theorem_2() -> None:
    assert [prbi_rounding.limit(how, 6, 3) for how in ("floor", "nearest", "ceiling")] == [3, 2.5, 2]
    assert prbi_rounding.limit("ceiling", 6, 1) == pytest.approx(0.263, abs=5e-4)


def test_since_when_something_holds() -> None:
    assert prbi_fleets.since(np.array([False, True, False, True, True])) == 4
    assert prbi_fleets.since(np.array([True, True])) == 1
    assert math.isinf(prbi_fleets.since(np.array([True, False])))


def test_fig_4_and_fig_5_end_with_the_attackers_alone() -> None:
    m, right = prbi_fleets.watch(6, 2, 0, 60)
    assert right[-1] and abs(m[-1] - 2) < 0.5
    run = prbi_probability.under_the_truth(prbi_probability.Args(frames=25), 2, 0)
    assert [i for i, p in enumerate(run.belief[-1]) if p == 1] == run.attackers


def test_the_trace_shows_a_saw_tooth() -> None:
    """Once the attackers alone are at zero, m is at most a step above k, and ⌊m⌋ = k is a peak."""
    m, zeros, _ = prbi_stopping.trace(prbi_stopping.Args(frames=120))
    late = slice(60, None)
    assert (zeros[late] == 4).all() and abs(m[late] - 4).max() < 0.3
    peaks = np.flatnonzero(m[late][:-1] >= 4)
    assert len(peaks) and (m[late][peaks + 1] < m[late][peaks]).all()
