"""A frozen detector that sees something without training, a bank of toy scenes, and environments that live in it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
from jaxtyping import config

from cp_env.detector import Detector
from cp_env.detector.model.decoder import Decoder
from cp_env.envs.parallel import CollaborativePerceptionEnv
from cp_env.world.scene_cache import SceneBank
from tests.helpers.toy_scenes import ToySource

FRAMES = 4


@pytest.fixture(scope="session")
def bank() -> SceneBank:
    """A narrow detector of random weights, its score bias raised until one in fifty cells passes the threshold."""
    torch.manual_seed(0)
    detector = Detector(channels=8)
    detector.decoder = Decoder(8, width=8, deep=8)
    detector.freeze().eval()
    source = ToySource(n_frames=FRAMES + 2)
    maps = detector.encode(source.sweeps(source.load("toy-0"), [0])[0])
    detector.decoder.head.bias[:4] -= detector.decode(maps.mean(0, keepdim=True)).logits.quantile(0.98)
    return SceneBank(source, detector, progress=False)


@pytest.fixture(scope="session")
def toy_env(bank: SceneBank) -> Callable[..., CollaborativePerceptionEnv]:
    """Makes environments of a few frames in the toy crossings; takes the options of `parallel_env`."""

    def make(defender: Any = "prbi", **options: Any) -> CollaborativePerceptionEnv:
        return CollaborativePerceptionEnv(defender, bank=bank, **{"max_frames": FRAMES, **options})

    return make


@pytest.fixture
def toy_town(bank: SceneBank, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever opens a named source opens the toy crossings."""
    monkeypatch.setattr("cp_env.world.world.open_source", lambda _: bank.source)
    monkeypatch.setattr("cp_env.world.world.open_detector", lambda *_, **__: bank.detector)
    monkeypatch.setattr("cp_env.world.world.SceneBank", lambda *_: bank)


@pytest.fixture
def unchecked_shapes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every other test checks shapes at run time; here the same few frames are played thousands of times."""
    monkeypatch.setattr(config, "jaxtyping_disable", True)
