"""How recorded scenes are drawn: the pace, the company, and that nothing but chance decides among what fits."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from cp_env.scenes.sumo import selection
from cp_env.scenes.sumo.regimes import FLOW, REGIMES, draw_selection, keeps, pace_of
from cp_env.scenes.sumo.traffic import DT, Tracks
from tests.helpers.toy_traffic import line_of_cars, town_without_streets

TOWN = replace(REGIMES["urban"], spread=0.0)
STREETS = town_without_streets(400)


def convoy(n: int, speed: float, spacing: float = 10.0, frames: int = selection.FRAMES) -> Tracks:
    """Cars that drive along y side by side."""
    tracks = line_of_cars(n, spacing, frames)
    tracks.pose[..., 1] = speed * DT * (np.arange(frames)[:, None] - frames / 2)
    return tracks


def test_of_four_scenes_one_waits() -> None:
    paces = Counter(pace_of(k) for k in range(40))
    assert paces == {"flows": 30, "waits": 10}


@pytest.mark.parametrize(("moving", "flows", "waits"), [(99, True, False), (60, True, True), (40, False, True)])
def test_the_paces_by_hand(moving: int, flows: bool, waits: bool) -> None:
    """So many of 99 steps at 6 m/s, the others at a stand of 0.2 s each."""
    speed = np.zeros((99, 1))
    speed[:moving] = 6.0
    assert keeps("flows", speed).tolist() == [flows] and keeps("waits", speed).tolist() == [waits]
    assert 99 - moving >= 25 or not waits, "five seconds are 25 steps"


def test_only_an_ego_that_keeps_the_pace_is_drawn() -> None:
    rng = np.random.default_rng(0)
    for speed, pace in ((FLOW + 0.5, "flows"), (FLOW - 0.5, None)):
        found = draw_selection(convoy(7, speed), STREETS, TOWN, "flows", rng)
        assert (found is not None) == (pace == "flows")
    assert draw_selection(convoy(7, 6.0), STREETS, TOWN, "waits", rng) is None


def test_whoever_drives_too_little_is_not_connected() -> None:
    tracks = convoy(9, 6.0)
    tracks.pose[:, 4, 1] = 0.0  # it stands between the others
    for seed in range(20):
        found = draw_selection(tracks, STREETS, TOWN, "flows", np.random.default_rng(seed))
        assert found is not None and 4 not in found.connected and len(found.connected) >= TOWN.least


def test_the_connected_stay_in_range_and_there_are_enough() -> None:
    regime = replace(TOWN, radio=25.0, least=5)
    for seed in range(20):
        found = draw_selection(convoy(12, 6.0), STREETS, regime, "flows", np.random.default_rng(seed))
        assert found is not None and len(found.connected) == 5
        assert (10.0 * np.abs(found.connected - found.connected[0]) <= 25).all()
    assert draw_selection(convoy(12, 6.0), STREETS, replace(regime, least=6), "flows", np.random.default_rng(0)) is None
    assert draw_selection(convoy(4, 6.0), STREETS, regime, "flows", np.random.default_rng(0)) is None


def test_every_fitting_ego_is_about_equally_likely() -> None:
    """Of twelve side by side the two outermost at each end have too few near."""
    regime = replace(TOWN, radio=25.0)
    drawn: Counter[int] = Counter()
    for seed in range(800):
        found = draw_selection(convoy(12, 6.0), STREETS, regime, "flows", np.random.default_rng(seed))
        assert found is not None
        drawn[int(found.connected[0])] += 1
    assert set(drawn) == set(range(2, 10)) and max(drawn.values()) < 1.5 * 100 and min(drawn.values()) > 100 / 1.5


def test_the_ego_stays_in_the_middle() -> None:
    near = town_without_streets(70.0)
    assert draw_selection(convoy(9, 6.0), near, TOWN, "flows", np.random.default_rng(0)) is not None
    assert draw_selection(convoy(9, 9.0), near, TOWN, "flows", np.random.default_rng(0)) is None, "it drives 180 m"


def test_the_junction_has_eight() -> None:
    found = draw_selection(convoy(12, 6.0, 3.0), STREETS, REGIMES["junction"], "flows", np.random.default_rng(0))
    assert found is not None and len(found.connected) == 8
