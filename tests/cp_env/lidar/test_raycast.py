"""Rays against boxes and ground: the slow twin."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from cp_env.lidar.raycast import GROUND, NOTHING, Mount, Prisms, trace
from tests.cp_env.lidar.test_sensor import tan
from tests.reference import lidar as textbook


def slopes(elevations: tuple[float, ...]) -> torch.Tensor:
    return torch.tensor([tan(e) for e in elevations])


def crowd(rng: np.random.Generator, n: int) -> Prisms:
    """n boxes of all sizes and headings strewn over ±40 m; they overlap now and then."""
    low, high = [-40, -40, -4, 0.3, 0.3, 0.3], [40, 40, 4, 15, 8, 7]
    return Prisms(rng.uniform(low, high, (n, 6)), rng.permutation(n))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("height", [0.4, 1.7, 6.0])
def test_every_ray_meets_what_the_textbook_says(seed: int, height: float) -> None:
    rng = np.random.default_rng(seed)
    worlds = [crowd(rng, 25), crowd(rng, 3), Prisms(np.empty((0, 6)), np.empty(0, dtype=int))]
    places = rng.uniform([-20, -20, -4], [20, 20, 4], (4, 3)).tolist()
    mounts = [Mount(w, x, y, height, yaw, carrier=w) for w, (x, y, yaw) in zip((0, 0, 1, 2), places, strict=True)]
    elevations = (-35.0, -12.0, -6.0, -2.0, -0.3, 0.7, 8.0)
    distance, owner = trace(worlds, mounts, slopes(elevations), azimuths=45, max_distance=200.0)
    for mount, own_distance, own_owner in zip(mounts, distance, owner, strict=True):
        expected, expected_owner = textbook.revolve(worlds[mount.world], mount, elevations, azimuths=45)
        slant = own_distance.numpy() / np.cos(np.radians(elevations))
        np.testing.assert_array_equal(own_owner, expected_owner)
        np.testing.assert_allclose(slant, expected, rtol=1e-6, atol=1e-3)


def test_owners_of_rays_that_meet_nothing_have_no_distance() -> None:
    world = crowd(np.random.default_rng(0), 5)
    distance, owner = trace([world], [Mount(0, 0.0, 0.0, 2.0)], slopes((-5.0, 5.0)), 30, 100.0)
    assert ((owner == NOTHING) == distance.isinf()).all() and (owner == GROUND).any()
