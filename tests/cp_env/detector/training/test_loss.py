"""L_det: targets worked by hand; a perfect answer costs nothing, a worse one more."""

from __future__ import annotations

import math

import pytest
import torch

from cp_env.detector import Dense
from cp_env.detector.training.loss import detection_loss, targets

SIZE, EXTENT = 16, 8.0  # cells of 1 m
BOXES = torch.tensor([[1.25, -3.5, 4.0, 2.0, math.pi / 4], [-5.0, 5.0, 6.0, 2.0, 0.0]])


def perfect(visible: torch.Tensor, boxes: torch.Tensor = BOXES) -> Dense:
    wanted = targets(boxes, visible, SIZE, EXTENT)
    return Dense(torch.where(wanted.heat == 1, 12.0, -12.0), wanted.boxes)


def test_targets_by_hand() -> None:
    both = targets(BOXES, torch.tensor([[True, True]]), SIZE, EXTENT)
    # the first centre, (1.25, -3.5), lies in column 9 (1 … 2 m), row 4 (-4 … -3 m), whose centre is (1.5, -3.5)
    assert (both.heat == 1).nonzero().tolist() == [[0, 4, 9], [0, 13, 3]]
    expected = [-0.25, 0.0, math.log(4), math.log(2), 1.0, 0.0]
    assert both.boxes[0, :, 4, 9].tolist() == pytest.approx(expected, abs=1e-6)
    assert both.boxes[0, :2, 5, 8].tolist() == pytest.approx([0.75, -1.0])  # from the north-western cell, (0.5, -2.5)
    assert both.heat[0, 4, 11] == pytest.approx(math.exp(-(2.25**2) / 2))
    assert (both.box_weight[0] > 0).sum() == 9 + 4 and (both.weight == 1).all()


def test_a_hidden_vehicle_is_not_judged() -> None:
    one = targets(BOXES, torch.tensor([[True, False]]), SIZE, EXTENT)
    assert (one.heat == 1).nonzero().tolist() == [[0, 4, 9]]
    assert one.weight[0, 13, 3] == 0 and one.weight[0, 4, 9] == 1 and one.weight[0, 0, 0] == 1
    ghost = perfect(torch.tensor([[True, True]]))  # it reports the hidden one all the same
    clean = perfect(torch.tensor([[True, False]]))
    assert detection_loss(ghost, one) == pytest.approx(detection_loss(clean, one).item(), abs=1e-4)


def test_perfect_is_nearly_free_and_errors_cost() -> None:
    visible = torch.tensor([[True, True], [True, False]])
    wanted = targets(BOXES, visible, SIZE, EXTENT)
    right = perfect(visible)
    floor = detection_loss(right, wanted)
    assert 0 <= floor < 0.01
    missed = right.logits.clone()
    missed[0, 4, 9] = -3.0
    ghost = right.logits.clone()
    ghost[1, 0, 0] = 3.0
    moved = right.boxes.clone()
    moved[0, 0, 4, 9] += 0.5
    for dense in (Dense(missed, right.boxes), Dense(ghost, right.boxes), Dense(right.logits, moved)):
        assert detection_loss(dense, wanted) > floor + 0.02


def test_an_empty_street() -> None:
    nothing = targets(torch.zeros(0, 5), torch.zeros(2, 0, dtype=torch.bool), SIZE, EXTENT)
    empty = Dense(torch.full((2, SIZE, SIZE), -12.0), torch.zeros(2, 6, SIZE, SIZE))
    assert detection_loss(empty, nothing) < 1e-4
    assert detection_loss(Dense(torch.zeros(2, SIZE, SIZE), empty.boxes), nothing) > 1
