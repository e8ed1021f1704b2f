"""Fusions without weights, against slow twins and by hand."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tests.helpers.received_maps import DETECTORS, GROUPS, SIZE, WORLD, C, Situation
from tests.reference import fusion as slow


@pytest.mark.parametrize("name", ["mean", "max", "sum"])
def test_slow_twin(name: str, situation: Situation) -> None:
    received, coverage = situation
    few = received[:, :, :3]
    expected = slow.FUSIONS[name](few.numpy(), coverage.numpy(), WORLD.numpy(), GROUPS.numpy())
    assert np.allclose(DETECTORS[name].fuse(few, coverage, WORLD, GROUPS), expected, atol=1e-6)


@pytest.mark.parametrize(("name", "both"), [("mean", 2), ("max", 3), ("sum", 4)])
def test_by_hand(name: str, both: int) -> None:
    # two senders show 1 and 3; the second covers the eastern half only
    received = torch.tensor([1.0, 3.0]).reshape(1, 2, 1, 1, 1).expand(1, 2, C, SIZE, SIZE)
    coverage = torch.ones(1, 2, SIZE, SIZE)
    coverage[0, 1, :, :16] = 0
    groups = torch.tensor([[True, True], [True, False], [False, True]])
    fused = DETECTORS[name].fuse(received, coverage, torch.zeros(3, dtype=torch.long), groups)
    assert (fused[0, :, :, :16] == 1).all() and (fused[0, :, :, 16:] == both).all()
    assert (fused[1] == 1).all()
    assert (fused[2, :, :, :16] == 0).all() and (fused[2, :, :, 16:] == 3).all()


def test_the_maximum_of_perturbations_below_zero_is_below_zero() -> None:
    received = torch.tensor([-2.0, -1.0]).reshape(1, 2, 1, 1, 1).expand(1, 2, C, SIZE, SIZE)
    coverage = torch.ones(1, 2, SIZE, SIZE)
    coverage[0, :, 0] = 0
    groups, world = torch.ones(1, 2, dtype=torch.bool), torch.zeros(1, dtype=torch.long)
    fused = DETECTORS["max"].fuse(received, coverage, world, groups)
    assert (fused[:, :, 0] == 0).all() and (fused[:, :, 1:] == -1).all()
