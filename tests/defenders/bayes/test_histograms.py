"""Measured densities: what is extrapolated, their bins, and broken files."""

from __future__ import annotations

import pytest

from defenders.bayes.histograms import likelihood_of, open_likelihood
from defenders.bayes.likelihood import Verifier
from defenders.calibration.files import read_calibration
from defenders.calibration.lookup import SHIPPED


@pytest.mark.parametrize("fusion", [path.stem for path in sorted(SHIPPED.glob("*.json"))])
def test_more_attackers_or_older_references_never_have_more_utility_on_average(fusion: str) -> None:
    """The shipped densities, measured or not."""
    likelihood = open_likelihood("calibrated", fusion)
    middle = (likelihood.edges[1:] + likelihood.edges[:-1]) / 2
    for size in (1, 2, 3, 5, 8, 12, 20):
        uncontaminated = [
            float(likelihood.uncontaminated(size, max(size, 5), size, age) @ middle)
            for age in range(1, likelihood.oldest + 1)
        ]
        assert uncontaminated == sorted(uncontaminated, reverse=True)
        for mode in range(1, likelihood.modes + 1):
            one, every = (likelihood.one_contaminated(size, attackers, 5, mode) @ middle for attackers in (1, size))
            assert every <= one + 0.05 and one < uncontaminated[0]
            assert 0 <= likelihood.utility(size, 1, mode) < likelihood.utility(size, 0) <= 1


def test_bins() -> None:
    likelihood = Verifier()
    assert [likelihood.bin(s) for s in (-0.1, 0.0, 0.49, 0.5, 1.0, 1.1)] == [0, 0, 0, 1, 1, 1]


def test_names_of_likelihoods() -> None:
    assert isinstance(open_likelihood("perfect"), Verifier)
    with pytest.raises(ValueError, match="likelihood must be"):
        open_likelihood("perhaps")
    with pytest.raises(ValueError, match="false_pass"):
        Verifier(false_pass=0.5)
    with pytest.raises(ValueError, match=r"no calibration file at nowhere\.json"):
        open_likelihood("nowhere.json")
    good = read_calibration(SHIPPED / "mean.json").densities()
    breaks = {
        "edges": [0, 0.5],
        "tail": 2,
        "both_contaminated": [[1.0]],
        "one_contaminated": good["one_contaminated"][:1],
        "uncontaminated": [],
        "full_view": [],
    }
    for name, value in breaks.items():
        with pytest.raises(ValueError, match=r"broken densities in mine\.json"):
            likelihood_of({**good, name: value}, "mine.json")
