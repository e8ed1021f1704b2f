"""What a view costs with each fusion, on one torch thread: `pytest benchmarks/test_fusion.py`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch

from cp_env.detector import load_detector
from cp_env.detector.model.fusion import FUSIONS

N, VIEWS = 5, 10


@pytest.mark.parametrize("name", FUSIONS)
def test_ten_views(benchmark: Callable[..., Any], name: str) -> None:
    """Fusion, decoding and boxes of ten groups of one world; two to three times a mean's are promised at most."""
    detector = load_detector(name)
    generator = torch.Generator().manual_seed(1)
    poses = torch.zeros(1, N, 3)
    poses[0, 1:, :2] = 2.0 * torch.randint(-8, 9, (N - 1, 2), generator=generator)
    maps = torch.rand(1, N, detector.channels, detector.size, detector.size, generator=generator)
    received, coverage = detector.warp(maps, poses), detector.coverage(poses)
    groups = torch.rand(VIEWS, N, generator=generator) < 0.6
    groups[:, 0] = True

    @torch.no_grad()
    def verify() -> None:
        detector.detect(detector.perceive(received, coverage, torch.zeros(VIEWS, dtype=torch.long), groups))

    benchmark(verify)
