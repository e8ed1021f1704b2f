"""Toy scenes cast for training, and a detector trained on them for a few steps."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from cp_env.detector import Detector
from cp_env.detector.model.weights import save_detector
from cp_env.detector.training.data import RasterisedScene, prepare
from tests.helpers.toy_scenes import ToySource


@pytest.fixture(scope="session")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> list[RasterisedScene]:
    return prepare(ToySource(n_frames=3), tmp_path_factory.mktemp("rasterised"), stride=2)


@pytest.fixture(scope="session")
def known(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Weights to start heads from."""
    path = tmp_path_factory.mktemp("weights") / "mean.safetensors"
    with torch.random.fork_rng():
        torch.manual_seed(2)
        save_detector(Detector(), path)
    return path
