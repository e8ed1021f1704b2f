"""Anchors and voxels of the detection files."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from cp_env.detector.coperception.heads import boxes_of
from cp_env.scenes.v2xsim.anchors import ANCHORS, decode, voxel_points
from tests.helpers.coperception_files import targets_of


@settings(max_examples=15)
@given(
    st.lists(
        st.tuples(st.floats(-31, 31), st.floats(-31, 31), st.floats(1.5, 3), st.floats(3, 12), st.floats(-3.1, 3.1)),
        min_size=1,
        max_size=4,
    )
)
def test_boxes_come_back_from_the_anchors(boxes: list[tuple[float, ...]]) -> None:
    apart = [box for k, box in enumerate(boxes) if all(np.hypot(*np.subtract(box, b)[:2]) > 3 for b in boxes[:k])]
    labels, targets, allocated, _ = targets_of(apart)
    found = decode(targets[allocated], allocated, labels[allocated])
    expected = np.array([(x, y, length, width, yaw) for x, y, width, length, yaw in apart])
    away = np.hypot(*(found[:, None, :2] - expected[None, :, :2]).T)
    assert len(found) == len(expected)
    found = found[away.argmin(axis=1)]
    assert_allclose(found[:, :4], expected[:, :4], atol=1e-5)
    assert_allclose(np.sin((found[:, 4] - expected[:, 4]) / 2), 0, atol=1e-6)


def test_a_target_by_hand() -> None:
    """A car at (12, 5), yaw 0.4, of 2 × 4 m.

    Mirrored it stands at u = -12, v = 5; cell (147, 79) has its middle at u = 79.5 / 4 - 32 = -12.125, v = 147.5 / 4 -
    32 = 4.875. The code's place is (-12.125 + 12) / 2 = -0.0625 and (4.875 - 5) / 4 = -0.03125. Its angle is 0.4 + π/2,
    of which sin is cos 0.4 = 0.921061 and cos is -sin 0.4 = -0.389418; from the anchors' own 0, π/2 and -π/4.
    """
    allocated = np.zeros((256, 256, 6), dtype=bool)
    allocated[147, 79, :3] = True
    s = math.sqrt(0.5)
    angles = [
        (0.921061, -0.389418),
        (0.389418, 0.921061),  # 0.4 from π/2
        (s * (0.921061 - 0.389418), s * (-0.389418 - 0.921061)),  # 0.4 + 3π/4
    ]
    codes = np.array([[-0.0625, -0.03125, 0.0, 0.0, *angle] for angle in angles])
    for k in range(3):
        one = np.zeros_like(allocated)
        one[147, 79, k] = True
        assert_allclose(decode(codes[[k]], one, np.array([1])), [[12, 5, 4, 2, 0.4]], atol=5e-6)
    assert_allclose(decode(codes, allocated, np.ones(3, dtype=int)), [[12, 5, 4, 2, 0.4]], atol=5e-6)
    assert not len(decode(codes, allocated, np.zeros(3, dtype=int))), "background is no car"
    wide = np.zeros_like(allocated)
    wide[147, 79, 4] = True  # (3, 12, π/2): ln(3 / 2) and ln(12 / 4)
    code = np.array([[-0.0625, -0.03125, 0.405465, 1.098612, *angles[1]]])
    assert_allclose(decode(code, wide, np.array([1])), [[12, 5, 4, 2, 0.4]], atol=5e-6)


def test_targets_are_read_as_the_detectors_heads_are() -> None:
    """A head that says what the targets say means the same box."""
    rng = np.random.default_rng(0)
    boxes = [(*rng.uniform(-31, 31, 2), *rng.uniform([1.5, 3], [3, 12]), rng.uniform(-3, 3)) for _ in range(6)]
    labels, targets, allocated, _ = targets_of(boxes)
    i, j, k = np.nonzero(allocated)
    index = torch.from_numpy((k * 256 + i) * 256 + j)[None]
    centre, size, double = boxes_of(torch.from_numpy(targets[allocated])[None], index)
    for n, place in enumerate(zip(i, j, k, strict=True)):
        one = np.zeros_like(allocated)
        one[place] = True
        ((x, y, length, width, yaw),) = decode(targets[one], one, labels[one])
        assert_allclose(centre[0, n], [x, y], atol=1e-5)
        assert_allclose(size[0, n].exp(), [length, width], atol=1e-5)
        assert_allclose(double[0, n], [math.sin(2 * yaw), math.cos(2 * yaw)], atol=1e-5)
    assert ANCHORS.shape == (6, 3)


def test_voxels_by_hand() -> None:
    """-3 m is no multiple of 0.4 m: the lowest slice of a vehicle begins at -3.2 m, of a road-side unit at -8 m."""
    first = np.array([[0, 255, 0]])
    assert_allclose(voxel_points(first, rsu=False), [[-31.875, 31.875, -3.0]])
    assert_allclose(voxel_points(first, rsu=True), [[-31.875, 31.875, -7.8]])
    with pytest.raises(ValueError, match="256 × 256 × 13"):
        voxel_points(np.array([[0, 256, 0]]), rsu=True)
