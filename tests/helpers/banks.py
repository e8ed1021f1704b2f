"""Fixtures: a frozen detector that sees something, without training, and an encoded bank of toy scenes."""

from __future__ import annotations

import pytest
import torch

from cp_env.detector import Detector
from cp_env.world.scene_cache import SceneBank
from tests.helpers.toy_scenes import ToySource


@pytest.fixture(scope="session")
def detector() -> Detector:
    """Random weights, their score bias raised until two in a hundred cells pass the operating threshold."""
    torch.manual_seed(0)
    detector = Detector().freeze()
    source = ToySource(n_frames=1)
    maps = detector.encode(source.sweeps(source.load("toy-0"), [0])[0])
    scores = detector.decode(maps.mean(0, keepdim=True)).logits
    detector.decoder.head.bias[:4] -= scores.quantile(0.98)
    return detector


@pytest.fixture(scope="session")
def bank(detector: Detector) -> SceneBank:
    """Two toy crossings of six frames."""
    return SceneBank(ToySource(n_frames=6), detector, progress=False)
