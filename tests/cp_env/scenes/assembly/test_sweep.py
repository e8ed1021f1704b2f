"""A sweep in place: chains beside a slow twin, hills made level after returns are counted."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from cp_env.scenes.assembly.road import Road
from cp_env.scenes.assembly.sweep import placed_sweep


def pose(rng: np.random.Generator, lean: float) -> np.ndarray:
    turn = Rotation.from_euler("ZYX", [rng.uniform(-3, 3), *rng.uniform(-lean, lean, 2)]).as_matrix()
    return np.column_stack([turn, rng.uniform(-5, 5, 3)])


@pytest.mark.parametrize("handed", [1, -1])
@pytest.mark.parametrize("seed", range(3))
def test_points_go_through_the_whole_chain(seed: int, handed: int) -> None:
    """One point at a time, of a right-handed file and of one whose y is to the right."""
    rng = np.random.default_rng(seed)
    world_T_sensor = pose(rng, 0.3)
    world_T_file = world_T_sensor * [1, handed, 1, 1]
    points = rng.normal(0, 20, (50, 3)).astype(np.float32)
    place, level = rng.uniform(-5, 5, 2), -3.0
    sweep = placed_sweep(
        points, world_T_file, Road.through(np.zeros((0, 3)), place, level), np.zeros((0, 7)), np.zeros((0, 2)), None
    )
    for point, found in zip(points, sweep.points, strict=True):
        world = world_T_sensor[:, :3] @ (point.astype(np.float64) * [1, handed, 1]) + world_T_sensor[:, 3]
        assert_allclose(found, world - (*place, level), atol=1e-4)
    assert_allclose(sweep.origin, [*place, world_T_sensor[2, 3] - level])
    assert sweep.hits is not None and sweep.hits.tolist() == []


def test_returns_are_counted_where_they_are_and_given_over_the_road() -> None:
    """By hand: a car 30 m ahead stands 3 m higher; its roof is 4.5 m over the ego's road, and 1.5 m over its own."""
    feet = np.array([[0.0, 0, 0], [30, 0, 3], [15, 4, 1.5], [15, -4, 1.5]])
    boxes = np.array([[0, 0, 0.75, 4, 2, 1.5, 0], [30, 0, 3.75, 4, 2, 1.5, 0]])
    sensor = np.column_stack([np.eye(3), [0, 0, 1.8]])
    points = np.array([[30, 0, 2.7], [30, 0.5, 1.5], [15, 0, -0.3], [1, 0.5, -0.3]], dtype=np.float32)
    road = Road.through(feet, np.zeros(2), 0.0)
    sweep = placed_sweep(points, sensor, road, boxes, np.zeros((2, 2)), 0)
    assert_allclose(sweep.points, [[30, 0, 1.5], [30, 0.5, 0.3], [15, 0, 0]], atol=0.15)
    assert sweep.hits is not None and sweep.hits.tolist() == [0, 2]
