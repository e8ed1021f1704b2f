"""From dense maps to boxes."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from cp_env.detector import Dense, Detector
from cp_env.detector.model.base import MOST_BOXES
from cp_env.detector.model.decoder import peaks
from cp_env.detector.training.loss import targets
from cp_env.geometry.boxes import pairwise_iou

DETECTOR = Detector()
SIZE, EXTENT = DETECTOR.map_size, DETECTOR.extent


def drawn(boxes: list[list[float]], scores: list[float]) -> Dense:
    """What a perfect decoder says of one view: these boxes, with these scores in the cells of their centres."""
    truth = torch.tensor(boxes)
    wanted = targets(truth, torch.ones(1, len(boxes), dtype=torch.bool), SIZE, EXTENT)
    logits = torch.where(wanted.heat == 1, 0.0, -9.0)
    for box, score in zip(boxes, scores, strict=True):
        logits[0, int((box[1] + EXTENT) // 1), int((box[0] + EXTENT) // 1)] = torch.tensor(score).logit()
    return Dense(logits, wanted.boxes)


CARS = [[10.3, -5.2, 4.5, 1.8, 0.4], [-20.9, 7.7, 9.0, 2.5, -1.2], [-12.0, 7.0, 4.5, 1.8, 3.0]]


def test_boxes_come_back_exactly() -> None:
    (found,) = DETECTOR.detect(drawn(CARS, [0.9, 0.5, 0.7]))
    assert found.scores == pytest.approx([0.9, 0.7, 0.5], abs=1e-6)
    overlap = pairwise_iou(found.boxes, np.array(CARS))  # up to a half turn, which no one sees from above
    assert overlap[[0, 1, 2], [0, 2, 1]] == pytest.approx(1.0, abs=1e-4)
    turn = found.boxes[:, 4] - np.array(CARS)[[0, 2, 1], 4]
    assert np.sin(turn) == pytest.approx(0.0, abs=1e-5)
    assert found.boxes[:, :4] == pytest.approx(np.array(CARS)[[0, 2, 1], :4], abs=1e-5)


def test_the_floor() -> None:
    (found,) = DETECTOR.detect(drawn(CARS, [0.9, 0.04, 0.06]))
    assert found.scores == pytest.approx([0.9, 0.06], abs=1e-6)


def test_the_egos_own_footprint_is_left_out() -> None:
    (found,) = DETECTOR.detect(drawn([[0.3, -0.4, 4.5, 1.8, 0.0], [0.3, 2.2, 4.5, 1.8, 0.0]], [0.9, 0.8]))
    assert found.boxes[:, :2] == pytest.approx(np.array([[0.3, 2.2]]), abs=1e-5)


def test_two_peaks_of_one_vehicle_give_one_box() -> None:
    twice = [[10.2, 4.5, 8.5, 2.5, 0.0], [12.4, 4.5, 8.5, 2.5, 0.0]]
    (found,) = DETECTOR.detect(drawn(twice, [0.6, 0.8]))
    assert len(found.scores) == 1 and found.scores[0] == pytest.approx(0.8)


def test_views_do_not_disturb_each_other() -> None:
    one, two = drawn(CARS, [0.9, 0.5, 0.7]), drawn(CARS[:1], [0.3])
    nothing = Dense(torch.full_like(one.logits, -9.0), torch.zeros_like(one.boxes))
    together = DETECTOR.detect(
        Dense(torch.cat([one.logits, nothing.logits, two.logits]), torch.cat([one.boxes, nothing.boxes, two.boxes]))
    )
    assert [len(found.scores) for found in together] == [3, 0, 1]
    for found, alone in zip(together, (one, nothing, two), strict=True):
        (expected,) = DETECTOR.detect(alone)
        assert np.array_equal(found.boxes, expected.boxes) and np.array_equal(found.scores, expected.scores)


def test_all_views_at_once_have_the_same_boxes_as_one_after_the_other() -> None:
    """The way of a device, here: random outputs, whose boxes crowd each other, seen from egos in several places."""
    generator = torch.Generator().manual_seed(0)
    dense = Dense(torch.randn(6, SIZE, SIZE, generator=generator), torch.randn(6, 6, SIZE, SIZE, generator=generator))
    for own in (None, np.random.default_rng(0).uniform(-5, 5, (6, 2))):
        expected = DETECTOR.detect(dense, own)
        found = DETECTOR._detected(*peaks(dense, DETECTOR.floor, EXTENT, MOST_BOXES), own)
        for one, other in zip(found, expected, strict=True):
            assert np.array_equal(one.boxes, other.boxes) and np.array_equal(one.scores, other.scores)
            assert 0 < len(one.scores) < MOST_BOXES


def test_nothing_asked_nothing_found() -> None:
    assert DETECTOR.detect(Dense(torch.zeros(0, SIZE, SIZE), torch.zeros(0, 6, SIZE, SIZE))) == []


def test_any_output_gives_sound_boxes() -> None:
    generator = torch.Generator().manual_seed(0)
    wild = Dense(
        20 * torch.randn(3, SIZE, SIZE, generator=generator), 30 * torch.randn(3, 6, SIZE, SIZE, generator=generator)
    )
    for found in DETECTOR.detect(wild):
        assert np.isfinite(found.boxes).all() and (found.boxes[:, 2:4] > 0).all()
        assert (np.diff(found.scores) <= 0).all() and (np.abs(found.boxes[:, :2]) <= EXTENT).all()
        overlap = pairwise_iou(found.boxes, found.boxes) - np.eye(len(found.boxes))
        assert overlap.max(initial=0) <= 0.15 + 1e-6


def test_encode_takes_sweeps() -> None:
    from tests.helpers.toy_scenes import ToySource

    source = ToySource()
    (sweeps,) = source.sweeps(source.load("toy-0"), [0])
    maps = DETECTOR.freeze().encode(sweeps[:2])
    assert maps.shape == (2, DETECTOR.channels, DETECTOR.size, DETECTOR.size)
    assert torch.allclose(maps[1], DETECTOR.encode(sweeps[1:2])[0], atol=1e-4)
    assert not torch.allclose(maps[0], maps[1], atol=1e-2)
