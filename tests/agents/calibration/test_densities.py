"""Histograms of similarities."""

from __future__ import annotations

import numpy as np
import pytest

from agents.calibration.comparisons import Episodes, Measurement, all_groups
from agents.calibration.densities import EDGES, Smoothing, by_kind, densities, left_out, part_of, smoothed
from defenders.bayes.histograms import likelihood_of

EPISODES = Episodes(n_vehicles=2, frames=5, ages=2, loud="pgd", stealthy=())


def measurement(scene: str, attackers: set[int], rng: np.random.Generator) -> Measurement:
    """Contaminated views are 0.1 similar to benign ones and 0.5 to each other, benign views 0.9; with noise."""
    groups = all_groups(2)
    level = np.array(
        [
            [
                0.9 if not (a & attackers or b & attackers) else 0.5 if a & attackers and b & attackers else 0.1
                for b in groups
            ]
            for a in groups
        ]
    )
    similarity = np.clip(level + rng.normal(0, 0.02, (5, 2, 3, 3)), 0, 1).astype(np.float32)
    if attackers:
        first = np.array([[0.9 if not a & attackers else 0.1 for _ in groups] for a in groups])
        similarity[1, 0] = first  # the reference is the benign first frame
        similarity[:, 1] = np.nan
    full = np.array([0.1 if attackers and not a & attackers else 0.9 for a in groups])
    return Measurement(
        scene,
        "pgd" if attackers else "none",
        frozenset(attackers),
        similarity,
        np.tile(full, (5, 1)).astype(np.float32),
    )


@pytest.fixture
def measurements() -> list[Measurement]:
    rng = np.random.default_rng(0)
    return [measurement(scene, attackers, rng) for scene in "ab" for attackers in (set(), {0}, {1})]


@pytest.mark.parametrize("bandwidth", [0.01, 0.08, 1.0])
def test_a_smoothed_histogram_sums_to_one_and_stays_where_the_values_are(bandwidth: float) -> None:
    values = [np.array([0.0, 0.55, 0.55, 1.0])]
    row = smoothed(values, EDGES, bandwidth)
    assert row.shape == (len(EDGES) - 1,) and row.sum() == pytest.approx(1) and (row >= 0).all()
    if bandwidth == 0.01:  # no kernel reaches over an edge: the shares are those of the values
        counted, _ = np.histogram(values[0], EDGES)
        np.testing.assert_allclose(row, counted / 4, atol=0.02)


def test_what_is_put_in_comes_out(measurements: list[Measurement]) -> None:
    """The likelihood's means are the levels that the measurements were made with."""
    smoothing = Smoothing(bandwidth=0.03, numbers=0.0, tail=1e-4)
    rows = densities(by_kind(measurements, EPISODES), 2, smoothing)
    likelihood = likelihood_of(part_of(rows, EPISODES, smoothing.tail))
    middle = (likelihood.edges[1:] + likelihood.edges[:-1]) / 2

    def mean(row: np.ndarray) -> float:
        return float(row @ middle)

    assert (likelihood.most, likelihood.modes, likelihood.oldest) == (2, 1, 2)
    assert mean(likelihood.uncontaminated(1, 1, 0, 1)) == pytest.approx(0.9, abs=0.06)
    assert mean(likelihood.one_contaminated(1, 1, 1)) == pytest.approx(0.1, abs=0.06)
    assert mean(likelihood.both_contaminated(1, 1)) == pytest.approx(0.5, abs=0.06)
    inner = (likelihood.full_view_edges[1:] + likelihood.full_view_edges[:-1]) / 2
    assert float(likelihood.full_view(1, 0, 2, 1) @ inner) == pytest.approx(0.1, abs=0.06)
    assert float(likelihood.full_view(1, 1, 2, 1) @ inner) == pytest.approx(0.9, abs=0.06)


def test_scenes_left_out_are_told_as_well_as_those_put_in(measurements: list[Measurement]) -> None:
    """Two scenes of one distribution: the log-likelihood of the other is better than that of a flat density."""
    scores = left_out(measurements, EPISODES, Smoothing())
    assert scores["uncontaminated"] > -np.log(len(EDGES) - 1) and scores["one_contaminated"] > -np.log(len(EDGES) - 1)
