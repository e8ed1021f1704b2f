from __future__ import annotations

import pytest
import torch

from cp_env.detector import Detector
from cp_env.world.scene_cache import SceneBank
from tests.helpers.toy_scenes import ToySource

FRAMES = 3
"""Length of a toy episode."""


@pytest.fixture(scope="session")
def bank(tmp_path_factory: pytest.TempPathFactory) -> SceneBank:
    """Two toy crossings under a small detector that sees something everywhere."""
    with torch.random.fork_rng():
        torch.manual_seed(0)
        detector = Detector(channels=8)
        with torch.no_grad():
            detector.decoder.head.bias.zero_()
    return SceneBank(ToySource(n_frames=FRAMES + 2), detector.freeze(), tmp_path_factory.mktemp("bank"), progress=False)
