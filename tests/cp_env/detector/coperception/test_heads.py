"""Boxes and scores of coperception's anchors."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from cp_env.detector.coperception import heads
from cp_env.geometry.boxes import rotated_iou
from tests.helpers.coperception_views import POSES, detector, ours
from tests.reference import coperception as twin


@pytest.fixture(scope="module")
def view() -> tuple[Tensor, Tensor]:
    return ours(detector(), POSES)


def test_boxes_are_theirs(view: tuple[Tensor, Tensor]) -> None:
    """Score and outline of every box above 0.7, after their suppression of polygons."""
    odds, codes = view
    threshold = odds.flatten().topk(400).values[-1] - math.log(0.7 / 0.3)
    odds = odds - threshold  # 400 anchors are sure
    scores = torch.stack([torch.zeros_like(odds), odds], dim=-1)[0].permute(1, 2, 0, 3).reshape(-1, 2)
    outlines, sure = twin.detections(scores, codes[0].permute(2, 3, 0, 1))
    found = heads.best_anchors(odds, codes, 0.05, 4096)
    kept = detector().detect(heads.Anchored(odds[:, 0], codes[:, 0], *found))[0].above(0.7)
    centre = outlines.mean(1) * [-1, 1]
    mine = (np.abs(centre) <= 32).all(1) & (np.linalg.norm(centre, axis=1) > 1.5)
    assert len(sure) > 20 and len(kept.scores) == mine.sum()
    assert np.allclose(kept.scores, sure[mine], atol=1e-6)
    edges = outlines[mine][:, [1, 2]] - outlines[mine][:, [0, 1]]
    (width, length), (dx, dy) = np.linalg.norm(edges, axis=2).T, edges[:, 1].T
    boxes = np.stack([*centre[mine].T, length, width, np.arctan2(dy, -dx)], axis=1)
    assert np.allclose(rotated_iou(kept.boxes, boxes), 1, atol=1e-3)


def test_a_cell_of_a_metre_says_what_its_best_anchor_does(view: tuple[Tensor, Tensor]) -> None:
    odds, codes = view
    logits, boxes = heads.reduce(odds, codes)
    rng = np.random.default_rng(0)
    for row, column in rng.integers(0, 64, size=(12, 2)):
        block = odds[0, :, 4 * row : 4 * row + 4, 4 * column : 4 * column + 4]
        anchor, r, c = (int(i) for i in np.unravel_index(int(block.argmax()), block.shape))
        assert logits[0, row, 63 - column] == block.max()
        code = codes[0, anchor, :, 4 * row + r, 4 * column + c].double().numpy()
        outline = twin.corners(code, 4 * row + r, 4 * column + c, anchor) * [-1, 1]
        dx, dy, log_length, log_width, sin, cos = boxes[0, :, row, 63 - column].double().tolist()
        centre = outline.mean(0)
        assert np.allclose([31.5 - column + dx, row - 31.5 + dy], centre, atol=1e-4)
        along = outline[1] - outline[2]
        assert np.allclose(math.exp(log_length), np.linalg.norm(along), atol=1e-4)
        assert np.allclose(math.exp(log_width), np.linalg.norm(outline[0] - outline[1]), atol=1e-4)
        yaw = math.atan2(along[1], along[0])
        assert np.allclose([sin, cos], [math.sin(2 * yaw), math.cos(2 * yaw)], atol=1e-4)
