"""Rigid motion in the plane: by hand, and as a group."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cp_env.geometry.planar import LATTICE, compose, corners, grid_origin, invert

NUMBER = st.floats(-50, 50)
POSE = st.tuples(NUMBER, NUMBER, st.floats(-7, 7)).map(np.array)


def as_matrix(pose: np.ndarray) -> np.ndarray:
    x, y, yaw = pose
    return np.array([[math.cos(yaw), -math.sin(yaw), x], [math.sin(yaw), math.cos(yaw), y], [0, 0, 1]])


def test_compose_worked_by_hand() -> None:
    """Standing at (1, 2) and facing north, three metres ahead and one to the left is (0, 5)."""
    a_T_b = np.array([1.0, 2.0, math.pi / 2])
    b_T_c = np.array([3.0, 1.0, math.pi / 2])
    np.testing.assert_allclose(compose(a_T_b, b_T_c), [0, 5, math.pi], atol=1e-12)


def test_invert_worked_by_hand() -> None:
    """Seen from there, the origin lies two metres behind and one to the left."""
    np.testing.assert_allclose(invert(np.array([1.0, 2.0, math.pi / 2])), [-2, 1, -math.pi / 2], atol=1e-12)


def test_corners_worked_by_hand() -> None:
    """Four metres long, two wide, facing north at (10, 20): front left is north-west."""
    box = np.array([10.0, 20.0, 4.0, 2.0, math.pi / 2])
    np.testing.assert_allclose(corners(box), [[9, 22], [9, 18], [11, 18], [11, 22]], atol=1e-12)


@given(POSE, POSE, POSE)
def test_poses_are_a_group_and_compose_like_matrices(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> None:
    np.testing.assert_allclose(as_matrix(compose(a, b)), as_matrix(a) @ as_matrix(b), atol=1e-9)
    np.testing.assert_allclose(compose(compose(a, b), c), compose(a, compose(b, c)), atol=1e-9)
    np.testing.assert_allclose(compose(a, invert(a)), 0, atol=1e-9)
    np.testing.assert_allclose(compose(invert(a), a), 0, atol=1e-9)
    np.testing.assert_array_equal(compose(a, np.zeros(3)), a)


@given(POSE, st.floats(0, 20), st.floats(0, 20))
def test_corners_are_a_rectangle_about_the_centre(pose: np.ndarray, length: float, width: float) -> None:
    shape = corners(np.array([pose[0], pose[1], length, width, pose[2]]))
    np.testing.assert_allclose(shape.mean(axis=0), pose[:2], atol=1e-9)
    sides = np.roll(shape, -1, axis=0) - shape
    np.testing.assert_allclose(np.hypot(*sides.T), [length, width, length, width], atol=1e-9)
    turn = sides[:, 0] * np.roll(sides, -1, axis=0)[:, 1] - sides[:, 1] * np.roll(sides, -1, axis=0)[:, 0]
    np.testing.assert_allclose(turn, length * width, atol=1e-7)  # square corners, counter-clockwise


@pytest.mark.parametrize("shape", [(), (3,), (2, 3)])
def test_leading_axes_are_kept(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(0)
    a, b, boxes = rng.random((*shape, 3)), rng.random((*shape, 3)), rng.random((*shape, 5))
    assert compose(a, b).shape == invert(a).shape == (*shape, 3)
    assert corners(boxes).shape == (*shape, 4, 2)
    if shape:
        np.testing.assert_array_equal(compose(a, b)[-1], compose(a[-1], b[-1]))
        np.testing.assert_array_equal(corners(boxes)[-1], corners(boxes[-1]))


def test_grid_origin_worked_by_hand() -> None:
    places = np.array([[0.0, 0.0], [0.9, -0.9], [1.1, -1.1], [101.3, 7.4]])
    np.testing.assert_array_equal(grid_origin(places), [[0, 0], [0, 0], [2, -2], [102, 8]])


@given(st.tuples(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4)).map(np.array))
def test_grid_origin_is_the_lattice_point_next_to_it(place: np.ndarray) -> None:
    origin = grid_origin(place)
    assert (np.abs(origin - place) <= LATTICE / 2).all()
    np.testing.assert_array_equal(origin % LATTICE, 0)
    np.testing.assert_array_equal(grid_origin(origin), origin)
