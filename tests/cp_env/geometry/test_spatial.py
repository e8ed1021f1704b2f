"""Rigid motion in space: by hand, and as a group."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cp_env.geometry.spatial import chain, heading, inverse, motion, rotation, upright

numbers = st.floats(-2, 2)
places = st.tuples(*[st.floats(-100, 100)] * 3)
quaternions = st.tuples(*[numbers] * 4).filter(lambda q: np.linalg.norm(q) > 0.1)


def moved(quaternion: tuple[float, ...], place: tuple[float, ...]) -> np.ndarray:
    unit = np.array(quaternion) / np.linalg.norm(quaternion)
    return motion(unit, np.array(place))


def test_a_quarter_turn_by_hand() -> None:
    """A sensor at (10, 20, 2) that looks north: what lies 3 m ahead of it and 1 m to its left is at (9, 23, 2)."""
    quarter = upright(np.array(np.pi / 2))
    assert quarter == pytest.approx([np.sqrt(0.5), 0, 0, np.sqrt(0.5)])
    world_T_sensor = motion(quarter, np.array([10.0, 20.0, 2.0]))
    assert world_T_sensor @ [3.0, 1.0, 0.0, 1.0] == pytest.approx([9, 23, 2])
    assert heading(world_T_sensor) == pytest.approx(np.pi / 2)


def test_half_a_turn_about_each_axis() -> None:
    halves = rotation(np.eye(4)[1:])  # about x, y, z
    assert [half.diagonal().tolist() for half in halves] == [[1, -1, -1], [-1, 1, -1], [-1, -1, 1]]


@given(st.floats(-3.1, 3.1))
def test_the_heading_of_an_upright_turn_is_the_turn(yaw: float) -> None:
    turned = rotation(upright(np.array(yaw)))
    assert heading(turned) == pytest.approx(yaw)
    assert turned[2] == pytest.approx([0, 0, 1]) and turned[:, 2] == pytest.approx([0, 0, 1])


@given(quaternions, places)
def test_a_rotation_keeps_lengths_and_handedness_and_its_inverse_undoes_it(
    quaternion: tuple[float, ...], place: tuple[float, ...]
) -> None:
    a_T_b = moved(quaternion, place)
    turned = a_T_b[:, :3]
    assert turned @ turned.T == pytest.approx(np.eye(3), abs=1e-9) and np.linalg.det(turned) == pytest.approx(1)
    assert chain(inverse(a_T_b), a_T_b) == pytest.approx(np.eye(3, 4), abs=1e-9)
    assert chain(a_T_b, inverse(a_T_b)) == pytest.approx(np.eye(3, 4), abs=1e-9)


@given(quaternions, places, quaternions, places, places)
def test_a_chain_takes_points_as_its_links_do_one_after_the_other(
    q: tuple[float, ...], p: tuple[float, ...], r: tuple[float, ...], s: tuple[float, ...], point: tuple[float, ...]
) -> None:
    a_T_b, b_T_c = moved(q, p), moved(r, s)
    seen_from_b = b_T_c @ [*point, 1.0]
    assert chain(a_T_b, b_T_c) @ [*point, 1.0] == pytest.approx(a_T_b @ [*seen_from_b, 1.0], abs=1e-8)


def test_leading_axes_are_kept() -> None:
    yaws = np.linspace(-1, 1, 6).reshape(2, 3)
    motions = motion(upright(yaws), np.ones((2, 3, 3)))
    assert motions.shape == (2, 3, 3, 4) and heading(motions) == pytest.approx(yaws)
    assert chain(motions, inverse(motions)) == pytest.approx(np.broadcast_to(np.eye(3, 4), (2, 3, 3, 4)), abs=1e-12)
