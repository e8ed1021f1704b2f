"""The Intelligent Driver Model: values worked by hand, and what it promises."""

from __future__ import annotations

import numpy as np
import pytest

from cp_env.driving.idm import CITY, DriverModel


def accelerate(speed: float, desired: float, gap: float, closing: float, driver: DriverModel = CITY) -> float:
    return float(driver(*(np.array([value], dtype=float) for value in (speed, desired, gap, closing)))[0])


def test_worked_by_hand() -> None:
    """a = 1, b = 1.5, T = 1, s0 = 2: s* = 2 + 10 + 10 · 5 / (2 √1.5) = 32.412; 1 − (10/15)⁴ − (32.412/40)²."""
    assert accelerate(10, 15, 40, 5) == pytest.approx(1 - (10 / 15) ** 4 - (32.41241 / 40) ** 2, abs=1e-5)


def test_a_free_road_is_driven_at_the_desired_speed() -> None:
    assert accelerate(0, 15, np.inf, 0) == 1.0
    assert accelerate(15, 15, np.inf, 0) == 0.0
    assert accelerate(15, 5, np.inf, 0) == -1.5, "no harder than is comfortable, our bound"


@pytest.mark.parametrize("speed", [0.0, 3.0, 9.0])
def test_the_equilibrium_gap(speed: float) -> None:
    """Treiber and Kesting, Eq. (11.19): s = (s0 + v T) / √(1 − (v/v0)^δ) behind a leader of the same speed."""
    gap = (2 + speed) / np.sqrt(1 - (speed / 15) ** 4)
    assert accelerate(speed, 15, gap, 0) == pytest.approx(0, abs=1e-12)


def test_braking_has_a_limit_and_grows_as_the_gap_shrinks() -> None:
    braking = [accelerate(10, 15, gap, 5) for gap in (80, 40, 20, 10, 1)]
    assert braking == sorted(braking, reverse=True)
    assert braking[-1] == -9.0
    assert accelerate(10, 15, 0.0, 5) == -9.0


def test_a_driver_behind_a_standing_car_stops_in_front_of_it() -> None:
    """From 50 km/h and 80 m, in steps of 0.2 s; it never brakes hard and stops about s0 before it."""
    speed, place, hardest = 50 / 3.6, 0.0, 0.0
    for _ in range(300):
        a = accelerate(speed, 15, 80 - place, speed)
        faster = max(speed + 0.2 * a, 0.0)
        place, speed, hardest = place + 0.1 * (speed + faster), faster, max(hardest, -a)
    assert speed < 0.05
    assert 77 < place < 79
    assert hardest < 4


def test_parameters_are_positive() -> None:
    with pytest.raises(ValueError, match="headway of a driver must be positive, not 0"):
        DriverModel(headway=0.0)
