"""Anchors and voxels of the detection files."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from cp_env.scenes.v2xsim.anchors import decode, voxel_points
from tests.helpers.coperception_files import _targets


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
    labels, targets, allocated, _ = _targets(apart)
    found = decode(targets[allocated], allocated, labels[allocated])
    expected = np.array([(x, y, length, width, yaw) for x, y, width, length, yaw in apart])
    found, expected = found[np.argsort(found[:, 0])], expected[np.argsort(expected[:, 0])]
    assert_allclose(found[:, :4], expected[:, :4], atol=1e-5)
    assert_allclose(np.sin((found[:, 4] - expected[:, 4]) / 2), 0, atol=1e-6)


def test_voxels_by_hand() -> None:
    """-3 m is no multiple of 0.4 m: the lowest slice of a vehicle begins at -3.2 m, of a road-side unit at -8 m."""
    first = np.array([[0, 255, 0]])
    assert_allclose(voxel_points(first, rsu=False), [[-31.875, 31.875, -3.0]])
    assert_allclose(voxel_points(first, rsu=True), [[-31.875, 31.875, -7.8]])
    with pytest.raises(ValueError, match="256 × 256 × 13"):
        voxel_points(np.array([[0, 256, 0]]), rsu=True)
