"""Where nothing was measured: references that are too old, attackers too few among too many, and mixed modes."""

from __future__ import annotations

import numpy as np
import pytest

from defenders.bayes.histograms import FADES
from tests.helpers.densities import made_up

SEEDS = range(5)
MOST, OLDEST = 3, 2
"""What `made_up` measures."""


@pytest.mark.parametrize("seed", SEEDS)
def test_a_reference_fades_from_the_oldest_age_that_was_measured_on(seed: int) -> None:
    likelihood = made_up(seed)
    one = likelihood.one_contaminated(1, 1, 1)
    for age in range(1, 8):
        none = likelihood.uncontaminated(1, 1, 1, min(age, OLDEST))
        expected = 0.5 * np.abs(one - none).sum() * FADES ** (age - min(age, OLDEST))
        assert likelihood.discrimination(age) == pytest.approx(expected)


@pytest.mark.parametrize("seed", SEEDS)
def test_two_modes_resemble_each_other_as_the_lower_does_itself(seed: int) -> None:
    likelihood = made_up(seed)
    for size, other in np.ndindex(4, 4):
        kinds = [likelihood.both_contaminated(size + 1, other + 1, *modes) for modes in ((1, 1), (1, 2), (2, 1))]
        assert (kinds[0] == kinds[1]).all() and (kinds[0] == kinds[2]).all()
        assert (likelihood.both_contaminated(size + 1, other + 1, 2, 2) != kinds[0]).any()


@pytest.mark.parametrize("seed", SEEDS)
def test_an_attacker_among_ever_more_vehicles_comes_to_show_as_none(seed: int) -> None:
    likelihood = made_up(seed)
    for other, mode in ((1, 1), (2, 2), (3, 1)):
        one = likelihood.one_contaminated(MOST, 1, other, mode)
        none = likelihood.uncontaminated(MOST, other, other, 1)
        for size, attackers in ((4, 1), (5, 1), (30, 1), (30, 9), (3000, 1)):
            share = attackers * MOST / size
            expected = share * one + (1 - share) * none
            assert likelihood.one_contaminated(size, attackers, other, mode) == pytest.approx(expected)
