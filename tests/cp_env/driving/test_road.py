"""Where the simulated ego has to wait, on roads built by hand."""

from __future__ import annotations

import pytest

from cp_env.driving.road import Road
from tests.helpers.roads import driving, road


def stopping(at: float, first: int, frames: int) -> list[tuple[float, float, float]]:
    """Drives 5 m/s up to a place, stands there for 20 frames and drives on."""
    x, track = 0.0, []
    for frame in range(frames):
        track.append((x, 0.0, 0.0))
        if not (x >= at and frame < first + 20):
            x += 1.0
    return track


def test_a_wait_with_nobody_ahead_is_a_line_and_is_known_five_seconds_before() -> None:
    (wait,) = Road.of(road([stopping(20, 20, 60)]), 0).waits
    assert wait.along == 20
    assert wait.first == 20 - 25
    assert wait.last == 39


def test_a_wait_behind_a_car_is_none() -> None:
    """The car stands 10 m before the bumper."""
    assert Road.of(road([stopping(20, 20, 60), driving(34, 0, 0, 60)]), 0).waits == []


def test_the_desired_speed_is_the_highest_recorded_or_thirty() -> None:
    assert Road.of(road([driving(0, 0, 12, 5)]), 0).desired == pytest.approx(12.0)
    assert Road.of(road([driving(0, 0, 2, 5)]), 0).desired == 30 / 3.6
