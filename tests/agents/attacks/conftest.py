"""Two recorded scenes under the shipped detector, for attacks that need real traffic."""

from __future__ import annotations

import pytest

from cp_env.detector import load_detector
from cp_env.scenes import open_source
from cp_env.scenes.clip import Clip
from cp_env.world.scene_cache import SceneBank
from tests.helpers.attacked_scenes import FRAMES


@pytest.fixture(scope="session")
def street() -> SceneBank:
    return SceneBank(Clip(open_source("town/calibration"), frames=FRAMES), load_detector(), progress=False)
