"""Detectors of every fusion, and maps received in two worlds."""

from __future__ import annotations

import pytest
import torch

from cp_env.detector import Detector
from cp_env.detector.model.fusion import FUSIONS
from tests.helpers.received_maps import DETECTORS, SIZE, C, E, N, Situation


@pytest.fixture(params=FUSIONS)
def detector(request: pytest.FixtureRequest) -> Detector:
    return DETECTORS[request.param]


@pytest.fixture(scope="session")
def situation() -> Situation:
    """Received maps and coverage of E worlds that differ; world 1's last sender is out of range."""
    generator = torch.Generator().manual_seed(3)
    poses = torch.zeros(E, N, 3)
    poses[:, 1:, :2] = 40 * (torch.rand(E, N - 1, 2, generator=generator) - 0.5)
    poses[1, 3, 0] = 80.0
    maps = torch.rand(E, N, C, SIZE, SIZE, generator=generator)
    return DETECTORS["mean"].warp(maps, poses), DETECTORS["mean"].coverage(poses)
