"""The choice of connected vehicles."""

from __future__ import annotations

import numpy as np
import pytest

from cp_env.scenes.sumo import selection
from cp_env.scenes.sumo.traffic import Tracks
from tests.helpers.toy_traffic import line_of_cars, town_without_streets


def test_a_selection_stays_in_radio_range() -> None:
    rng = np.random.default_rng(0)
    selected = selection.candidates(line_of_cars(9, 12.0), town_without_streets(200), rng, 1, standing="last")[0]
    gap = 12.0 * np.abs(selected.connected[1:] - selected.connected[0])
    assert len(selected.connected) >= 5 and gap.max() < selection.RADIO
    assert (np.diff(gap[:4]) >= 0).all() and (np.diff(gap[4:]) >= 0).all()


def test_the_first_partners_spread_out() -> None:
    """At 6 m in a queue every second vehicle is taken first: neighbours would see the same."""
    rng = np.random.default_rng(0)
    selected = selection.candidates(line_of_cars(30, 6.0), town_without_streets(400), rng, 1, least=8, standing="last")[
        0
    ]
    first = np.sort(selected.connected[:5])
    assert (6.0 * np.diff(first) >= selection.SPREAD).all()


def test_no_selection_without_company_or_far_from_the_middle() -> None:
    rng = np.random.default_rng(0)
    assert selection.candidates(line_of_cars(4, 10.0), town_without_streets(200), rng, 3, standing="last") == []
    assert selection.candidates(line_of_cars(9, 40.0), town_without_streets(900), rng, 3, standing="last") == []
    far = line_of_cars(9, 10.0)
    far.pose[..., 1] = 500
    assert selection.candidates(far, town_without_streets(100), rng, 3, standing="last") == []


def queue(n: int, moving: set[int], speed: float = 3.0) -> Tracks:
    """Cars 8 m apart along x; those that move drive along y, side by side."""
    tracks = line_of_cars(n, 8.0)
    time = 0.2 * np.arange(selection.FRAMES)
    for row in moving:
        tracks.pose[:, row, 1] = speed * (time - 10)
    return tracks


def chosen(tracks: Tracks, standing: selection.Standing, least: int = 5) -> list[set[int]]:
    rng = np.random.default_rng(0)
    town = town_without_streets(400)
    found = selection.candidates(tracks, town, rng, 3, least=least, standing=standing)
    return [set(selected.connected.tolist()) for selected in found]


def test_whoever_stands_is_not_chosen_where_enough_move() -> None:
    tracks = queue(12, moving=set(range(0, 12, 2)))
    for standing in ("never", "last"):
        found = chosen(tracks, standing)
        assert found and all(len(rows & set(range(0, 12, 2))) >= 5 for rows in found)
    assert all(rows <= set(range(0, 12, 2)) for rows in chosen(tracks, "never"))


def test_whoever_stands_fills_up_where_too_few_move() -> None:
    tracks = queue(8, moving={1, 3})
    assert chosen(tracks, "never") == []
    found = chosen(tracks, "last")
    assert found and all(rows >= {1, 3} and len(rows) == 5 for rows in found), "and no further than to those asked for"
    assert chosen(line_of_cars(6, 8.0), "last") and not chosen(line_of_cars(6, 8.0), "never")


def test_the_partners_that_move_come_first() -> None:
    tracks = queue(9, moving={0, 2, 7})
    rng = np.random.default_rng(0)
    selected = selection.candidates(tracks, town_without_streets(400), rng, 1, standing="last")[0]
    assert set(selected.connected[:3].tolist()) == {0, 2, 7}


@pytest.mark.parametrize(("speed", "still"), [(0.0, True), (0.4, True), (0.6, False), (10.0, False)])
def test_ten_metres_in_twenty_seconds_are_no_standing(speed: float, still: bool) -> None:
    place = queue(2, {0, 1}, speed).pose[:, :, :2]
    assert selection.stands(place).tolist() == [still, still]


def test_the_share_of_the_time_in_which_one_drives() -> None:
    """One drives all the time, one the last half of it, one never, and one creeps at 0.4 m/s."""
    time = 0.2 * selection.SAMPLE * np.arange(11)
    place = np.zeros((11, 4, 2))
    place[:, 0, 0], place[:, 1, 1], place[:, 3, 0] = 5 * time, 5 * np.maximum(time - time[5], 0), 0.4 * time
    shares = [selection._driving(place[:, [k]]) for k in range(4)]
    assert np.allclose(shares, [1, 0.5, 0, 0]) and selection._driving(place) == 0.375
