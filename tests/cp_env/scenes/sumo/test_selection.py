"""The choice of connected vehicles."""

from __future__ import annotations

import numpy as np

from cp_env.scenes.sumo import selection
from tests.helpers.toy_traffic import line_of_cars, town_without_streets


def test_a_selection_stays_in_radio_range() -> None:
    rng = np.random.default_rng(0)
    selected = selection.candidates(line_of_cars(9, 12.0), town_without_streets(200), rng, 1)[0]
    gap = 12.0 * np.abs(selected.connected[1:] - selected.connected[0])
    assert len(selected.connected) >= 5 and gap.max() < selection.RADIO
    assert (np.diff(gap[:4]) >= 0).all() and (np.diff(gap[4:]) >= 0).all()


def test_the_first_partners_spread_out() -> None:
    """At 6 m in a queue every second vehicle is taken first: neighbours would see the same."""
    rng = np.random.default_rng(0)
    selected = selection.candidates(line_of_cars(30, 6.0), town_without_streets(400), rng, 1)[0]
    first = np.sort(selected.connected[:5])
    assert (6.0 * np.diff(first) >= selection.SPREAD).all()


def test_no_selection_without_company_or_far_from_the_middle() -> None:
    rng = np.random.default_rng(0)
    assert selection.candidates(line_of_cars(4, 10.0), town_without_streets(200), rng, 3) == []
    assert selection.candidates(line_of_cars(9, 40.0), town_without_streets(900), rng, 3) == []
    far = line_of_cars(9, 10.0)
    far.pose[..., 1] = 500
    assert selection.candidates(far, town_without_streets(100), rng, 3) == []
