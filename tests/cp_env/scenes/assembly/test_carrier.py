"""Whose box is under a sensor, and what its track holds."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from cp_env.scenes.assembly.carrier import UNSEEN, Track, under_sensor

HALF = np.array([2.0, 1.0, 0.75])


def track(places: list[tuple[float, float, float] | None], z: float = 0.75) -> Track:
    """Boxes of 4 × 2 × 1.5 m at x, y, yaw; None where it is not listed."""
    made = Track.blank(len(places), np.zeros(3), HALF, "car")
    for t, place in enumerate(places):
        if place is not None:
            c, s = np.cos(place[2]), np.sin(place[2])
            pose = np.array([[c, -s, 0, place[0]], [s, c, 0, place[1]], [0, 0, 1, z]])
            made.put(t, pose, made.center, z - 0.75)
    return made


def test_a_track_by_hand() -> None:
    """A body pitched by 0.1 rad, its box 1 m ahead of its origin: 1 · cos 0.1 ahead, 1 · sin 0.1 below."""
    made = Track.blank(2, np.array([1.0, 0, 0]), HALF, None)
    c, s = np.cos(0.1), np.sin(0.1)
    made.put(1, np.array([[c, 0, s, 5.0], [0, 1, 0, 6], [-s, 0, c, 7]]), made.center, 6.2)
    assert np.isnan(made.boxes()[0]).any() and np.isnan(made.base[0])
    assert_allclose(made.boxes()[1], [5 + c, 6, 7 - s, 4, 2, 1.5, 0], atol=1e-12)
    assert_allclose([*made.tilt[1], made.base[1]], [0, 0.1, 6.2], atol=1e-12)
    twin = made.copy()
    twin.pose[1] = 0
    assert made.pose[1, 0] > 5


def test_it_is_what_stands_under_the_sensor_most_of_the_time() -> None:
    sensor = np.array([[0.5 + t, 0, 0] for t in range(4)])
    own = track([(0, 0.2, 0), None, (2, 0.2, 0), (3, 0.2, 0)])
    passing = track([(-9, 2.4, 0), (-3, 2.4, 0), (3, 2.4, 0), (9, 2.4, 0)])
    keys, found = under_sensor(sensor, {7: own, 8: passing})
    assert keys == {7} and found.kind == "car"
    assert_allclose(found.pose[:, :2], [[0, 0.2], [1, 0.2], [2, 0.2], [3, 0.2]], atol=1e-12)
    assert np.isnan(found.z[1]) and found.z[0] == 0.75, "its height is found later"


def test_nothing_under_it_is_a_car_of_a_usual_size() -> None:
    sensor = np.array([[4.0, 5, 0.3]])
    keys, found = under_sensor(sensor, {1: track([(40, 0, 0)])})
    assert not keys and found.extent is UNSEEN[1] and found.kind is None
    assert_allclose(found.pose, sensor)
