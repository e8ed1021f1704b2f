"""Maps are moved to the ego's frame as the detector's own warp moves them, wherever they are written."""

from __future__ import annotations

import pytest
import torch

from cp_env.detector import Detector
from cp_env.world import received

POSES = {
    "whole cells": [(0.0, 0.0, 0.0), (4.0, -6.0, 0.0), (-62.0, 2.0, 0.0), (200.0, 0.0, 0.0)],
    "rows end elsewhere": [(-6.0, 64.0, 0.0), (10.0, -64.0, 0.0), (62.0, 62.0, 0.0), (-200.0, -2.0, 0.0)],
    "fractions": [(0.0, 0.0, 0.0), (4.3, -6.0, 0.0), (0.0, 2.0, 0.4), (1.0, 1.0, 3.0)],
}


class Mirror(Detector):
    """A detector with a warp of its own."""

    def warp(self, maps: torch.Tensor, ego_T_sender: torch.Tensor) -> torch.Tensor:
        return super().warp(maps, ego_T_sender).flip(-1)


@pytest.fixture(params=[Detector, Mirror])
def detector(request: pytest.FixtureRequest) -> Detector:
    made: Detector = request.param(channels=3)
    return made.freeze()


@pytest.mark.parametrize("kind", POSES)
def test_writing_is_the_warp_and_leaves_other_rows(detector: Detector, kind: str) -> None:
    maps, pose = torch.randn(4, 3, 32, 32).half(), torch.tensor(POSES[kind])
    target = torch.full((7, 3, 32, 32), 9.0)
    rows = [5, 0, 3, 6]
    received.write(detector, target, rows, list(maps), pose)
    assert torch.equal(target[rows], detector.warp(maps.float(), pose))
    assert (target[[1, 2, 4]] == 9).all()


@pytest.mark.parametrize("kind", POSES)
def test_adding_is_the_warp_on_top(detector: Detector, kind: str) -> None:
    maps, pose = torch.randn(4, 3, 32, 32), torch.tensor(POSES[kind])
    before = torch.randn(7, 3, 32, 32)
    target, rows = before.clone(), [5, 0, 3, 6]
    received.add(detector, target, rows, maps, pose)
    assert torch.equal(target[rows], before[rows] + detector.warp(maps, pose))
    assert torch.equal(target[[1, 2, 4]], before[[1, 2, 4]])


def test_a_sum_of_less_precision_is_rounded_once() -> None:
    detector, maps = Detector(channels=3).freeze(), torch.randn(8, 3, 32, 32)
    pose = torch.tensor(POSES["whole cells"] + POSES["rows end elsewhere"])
    before = torch.randn(8, 3, 32, 32).bfloat16()
    target, moved = before.clone(), detector.warp(maps, pose)
    received.add(detector, target, list(range(8)), maps, pose)
    assert torch.equal(target, (before.float() + moved).bfloat16())


def test_a_target_of_less_precision_takes_the_nearest_numbers() -> None:
    detector, maps, pose = (
        Detector(channels=3).freeze(),
        torch.randn(2, 3, 32, 32).half(),
        torch.tensor(POSES["whole cells"][:2]),
    )
    target = torch.zeros(2, 3, 32, 32, dtype=torch.bfloat16)
    received.write(detector, target, [0, 1], list(maps), pose)
    assert torch.equal(target, detector.warp(maps.float(), pose).bfloat16())
