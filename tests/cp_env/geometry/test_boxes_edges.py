"""A threshold must be exceeded: an overlap of exactly that much neither matches nor suppresses."""

from __future__ import annotations

import numpy as np
import pytest

from cp_env.geometry.boxes import nms, overlaps, pairwise_iou


@pytest.mark.parametrize("seed", range(20))
def test_exactly_the_threshold_is_not_above_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a = np.array([[*rng.uniform(-1, 1, 2), 4.0, 2.0, rng.uniform(-3, 3)]])
    b = np.array([[*rng.uniform(-1, 1, 2), 5.0, 2.2, rng.uniform(-3, 3)]])
    iou = float(pairwise_iou(a, b)[0, 0])
    below = float(np.nextafter(iou, 0))
    assert 0 < iou < 1
    assert [len(overlaps([a], [b], above)[3]) for above in (iou, below)] == [0, 1]
    boxes, scores = np.concatenate([a, b]), np.array([0.9, 0.5])
    assert [nms(boxes, scores, limit).tolist() for limit in (iou, below)] == [[0, 1], [0]]


def test_without_overlap_there_is_no_pair_even_above_zero() -> None:
    """Circles meet, boxes do not."""
    a, b = np.array([[0.0, 0.0, 4.0, 2.0, 0.0]]), np.array([[0.0, 3.0, 4.0, 2.0, 0.0]])
    assert len(overlaps([a], [b], 0.0)[3]) == 0
    assert nms(np.concatenate([a, b]), np.array([0.9, 0.5]), 0.0).tolist() == [0, 1]
