"""Distillation: early fusion teaches a student."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from cp_env.detector import Detector
from cp_env.detector.model import bev
from cp_env.detector.model.weights import read_detector
from cp_env.detector.training.data import RasterisedScene, draw
from cp_env.detector.training.distillation import divergence, early_fusion, features, teach
from cp_env.detector.training.train import batch_loss
from tests.helpers.tiny_training import _overlap


def test_early_fusion_is_every_return_in_one_grid(scenes: list[RasterisedScene]) -> None:
    batch = draw(scenes, np.random.default_rng(1), frames=1, egos=1, views=3, agents=3)
    grids = early_fusion(batch, 32.0)
    cells = (batch.ego_T_sender[0, :, :2] / bev.BEV.cell).round().int().tolist()
    for row, group in zip(grids, batch.groups, strict=True):
        union = torch.zeros_like(batch.occupancy[0])
        for sweep, (x, y), member in zip(batch.agent[0].tolist(), cells, group.tolist(), strict=True):
            if member:
                for layer, joint in zip(batch.occupancy[sweep], union, strict=True):
                    source, target = _overlap(layer, joint, x, y)
                    target.copy_(torch.maximum(target, source))
        assert torch.equal(row, union.float()) and row.any()


def test_distillation_by_hand_and_at_its_floor(scenes: list[RasterisedScene]) -> None:
    ours = torch.tensor([0.0, 0.0]).reshape(1, 2, 1, 1)
    theirs = torch.tensor([np.log(3.0), 0.0]).reshape(1, 2, 1, 1).float()  # softmax 3/4, 1/4 against 1/2, 1/2
    by_hand = 0.75 * np.log(1.5) + 0.25 * np.log(0.5)
    assert divergence([ours, ours], [theirs, ours]).item() == pytest.approx(by_hand, rel=1e-5)
    torch.manual_seed(0)
    teacher = Detector().eval().requires_grad_(False)
    batch = draw(scenes, np.random.default_rng(0), frames=1, egos=1, views=2, agents=2)
    taught = teach(teacher, batch)
    same, seen = features(teacher, teacher.encode_grids(early_fusion(batch, 32.0)))
    assert divergence(seen, taught).item() == pytest.approx(0, abs=1e-6)
    assert len(taught) == 3 and same.logits.shape == (2, 64, 64)


def test_a_student_is_drawn_to_its_teacher(known: Path, scenes: list[RasterisedScene]) -> None:
    batch = draw(scenes, np.random.default_rng(0), frames=1, egos=1, views=2, agents=3)
    teacher = read_detector(known).eval().requires_grad_(False)
    student = Detector(fusion="disconet")
    alone = batch_loss(student, batch)
    taught = batch_loss(student, batch, teacher=teacher, weight=2.0)
    assert taught > alone
    taught.backward()
    assert all(parameter.grad is not None for parameter in student.fuser.parameters())
    assert all(parameter.grad is None for parameter in teacher.parameters())
