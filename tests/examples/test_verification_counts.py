"""The programs that reproduce Tables 1 and 2, and the one that calibrates PASAC, against numbers worked by hand."""

from __future__ import annotations

import numpy as np
import pytest

from agents.calibration import ego_view
from agents.calibration.samples import errors, no_samples
from cp_env.scenes import open_source
from examples.reproduce import clean_groups, robosac_budget, verification_counts
from tests.helpers.toy_scenes import ToySource


@pytest.mark.parametrize("n", [2, 5, 7])
def test_an_independently_drawn_group_is_clean_as_eq_3_says(n: int) -> None:
    for k in range(1, n):
        assert clean_groups.limit("independent", n, k) == pytest.approx((2 ** (n - k) - 1) / (2**n - 1))


def test_other_splits_of_five() -> None:
    """Halves of 2 and 3: both attackers in one with (1 + 3)/10. Even: 1|4 or 2|3, so (6/10 + 4/10)/2 of the frames."""
    assert [clean_groups.limit("half", 5, k) for k in (1, 2, 3, 4)] == pytest.approx([0.5, 0.2, 0.05, 0])
    assert [clean_groups.limit("even", 5, k) for k in (1, 2, 3, 4)] == pytest.approx([0.5, 0.25, 0.125, 0.05])


@pytest.mark.parametrize("split", clean_groups.SPLITS)
def test_what_is_played_comes_to_its_limit(split: str) -> None:
    args = clean_groups.Args(episodes=300, frames=150)
    for k in (1, 3):
        eta = clean_groups.played(split, k, args)
        assert ((eta >= 0) & (eta <= 0.5)).all()
        assert eta[:, -1].mean() == pytest.approx(clean_groups.limit(split, 5, k), abs=0.01)


def test_when_a_share_has_settled() -> None:
    eta = np.array([[0.9, 0.5, 0.7, 0.52, 0.49], [0.5, 0.5, 0.5, 0.5, 0.5], [0.5, 0.5, 0.5, 0.5, 0.9]])
    assert clean_groups.settled(eta, 0.5, 0.05).tolist() == [4, 1, 6]


def test_what_robosac_promises_and_keeps() -> None:
    """k = 1 of 5 and N = 9: 1 - (4/5)^9 = 0.866 of the frames find the four, where 0.99 was asked for."""
    args = robosac_budget.Args(frames=400)
    k, tries, formula, size, found, exact, paid = robosac_budget.row("replacement", 1, 1, args)
    assert (k, tries, formula, size, exact) == ("1", "9", "4", "4", "0.866")
    assert float(found.split()[0]) == pytest.approx(0.866, abs=0.05)
    assert float(paid) == pytest.approx(5 * (1 - 0.8**9), abs=0.6)  # a geometric number of tries, cut at 9
    assert robosac_budget.row("budgeted", 2, 5, args)[4] == "refused"


def test_thresholds_separate_benign_groups_from_others() -> None:
    """Two attackers count as much as one: below 0.5 no benign group fails, above 0.3 half the groups of one pass."""
    found = no_samples()
    found[2, 0]["a"] = [0.5, 0.6, 0.7, 0.8]
    found[2, 1]["a"], found[2, 2]["b"] = [0.1, 0.9], [0.2, 0.3, 0.1, 0.1]
    assert errors(found, 2, 0.4, strict=True) == (0.0, 0.25)
    assert errors(found, 2, 0.65, strict=True) == (0.5, 0.25)
    assert 0.3 <= ego_view.threshold(found, 2) < 0.5


def test_counts_over_episodes_that_end() -> None:
    """The mean is over frames, not over episodes: (2 + 4 + 3) / 3."""
    counts = np.array([[2, 4], [3, -1]])
    interval = verification_counts.mean(counts, seed=0)
    assert interval.mean == 3.0 and interval.low == interval.high == 3.0
    assert verification_counts.pooled(counts).tolist() == [2, 4, 3]


@pytest.mark.parametrize(("k", "least", "most"), [(1, 2, 2), (2, 2, 4), (3, 2, 6), (4, 2, 8)])
def test_prbi_in_its_first_abnormal_frame(k: int, least: int, most: int) -> None:
    args = verification_counts.Args(prbi_episodes=25)
    counts = verification_counts.count("PRBI, first abnormal frame", k, args)
    assert counts.shape == (25, 1) and least <= counts.min() and counts.max() <= most


def test_the_same_count_on_the_detector() -> None:
    """Three collaborators on toy scenes: two to four verifications in each of the two frames under attack."""
    args = verification_counts.Args(n=3, scenes=ToySource(n_frames=3), n_scenes=1, frames=3)
    counts = verification_counts.count_on_detector("PASAC", 1, args)
    assert counts.shape == (1, 2) and counts.min() >= 2 and counts.max() <= 4


def test_scenes_of_the_detector_hold_the_ego_and_its_collaborators() -> None:
    args = verification_counts.Args()
    source = open_source(args.scenes)
    assert all(source.load(name).n_connected > args.n for name in source.names())
