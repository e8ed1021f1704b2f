"""Points handed over from a sensor, and counted in boxes, against the plain and slow ways."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_array_equal

from cp_env.lidar.returns import CLEARANCE, MARGIN, count_returns, to_world_axes


def test_returns_in_boxes_against_a_loop() -> None:
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-30, 30, (3000, 2)), rng.uniform(0, 3, 3000)])
    centre = np.column_stack([rng.uniform(-50, 50, (60, 2)), rng.uniform(0.5, 1.5, 60)])
    size, yaw = rng.uniform(1, 12, (60, 3)), rng.uniform(-4, 4, 60)
    centre[3] = np.nan
    boxes = np.column_stack([centre, size, yaw])
    hits = count_returns(points, boxes)
    for k in range(60):
        turn = np.array([[np.cos(yaw[k]), -np.sin(yaw[k])], [np.sin(yaw[k]), np.cos(yaw[k])]])
        own = np.column_stack([(points - centre[k])[:, :2] @ turn, points[:, 2] - centre[k, 2]])
        inside = (np.abs(own) <= size[k] / 2 + MARGIN).all(axis=1) & (own[:, 2] >= CLEARANCE - size[k, 2] / 2)
        assert hits[k] == inside.sum()
    assert hits.sum() > 100 and count_returns(points[:0], boxes).tolist() == [0] * 60
    assert count_returns(points, boxes + np.eye(7)[0] * 1000).sum() == 0
    astray = np.concatenate([points, [[1e9, 0, 1], [0, -1e9, 1]]])
    assert (count_returns(astray, boxes) == hits).all(), "one wild point costs no memory"
    assert (count_returns(points, np.concatenate([boxes, [[1e9, 1e9, 1, 4, 2, 2, 0]]]))[:60] == hits).all()


def test_points_are_handed_over_as_by_one_plain_formula() -> None:
    rng = np.random.default_rng(1)
    for dtype, own in ((np.float32, 2), (np.float64, 0), (np.float32, None)):
        points = rng.normal(0, 6, (20_000, 3)).astype(dtype)
        turn, shift = np.linalg.qr(rng.normal(size=(3, 3)))[0], rng.normal(size=3)
        boxes = np.column_stack([rng.normal(0, 3, (5, 3)), rng.uniform(2, 6, (5, 3)), rng.uniform(-4, 4, 5)])
        told, hits = to_world_axes(points, turn, shift, boxes, own)
        plain = points @ turn.T.astype(dtype) + shift.astype(dtype)
        if own is not None:
            x, y, _, length, width, _, yaw = boxes[own]
            dx, dy = (plain[:, :2] - np.array([x, y], dtype=dtype)).T
            along, across = np.cos(yaw) * dx + np.sin(yaw) * dy, np.cos(yaw) * dy - np.sin(yaw) * dx
            over = (np.abs(along) <= length / 2 + MARGIN) & (np.abs(across) <= width / 2 + MARGIN)
            assert over.sum() > 50
            plain = plain[~over]
        assert_array_equal(told, plain)
        assert told.dtype == dtype and told.flags.c_contiguous
        assert_array_equal(hits, count_returns(plain, boxes))
