"""The shipped detector on toy crossings of three vehicles, and the smallest plan that measures all parts."""

from __future__ import annotations

from typing import Any

import pytest

from agents.calibration import Plan
from agents.calibration.comparisons import Episodes
from cp_env.detector import load_detector
from cp_env.world.scene_cache import SceneBank
from cp_env.world.world import World
from tests.helpers.toy_scenes import ToySource


@pytest.fixture(scope="package")
def toy_bank() -> SceneBank:
    return SceneBank(ToySource(n_frames=5, n_connected=3), load_detector(), progress=False)


@pytest.fixture(scope="package")
def small() -> Plan:
    episodes = Episodes(n_vehicles=3, frames=4, ages=2, loud="pgd:steps=2", stealthy=("ramp:steps=1",))
    return Plan(names=("toy-0",), attack="pgd:steps=2", previous_frames=3, ego_frames=2, episodes=episodes)


@pytest.fixture
def starts(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The first frames of all episodes that are begun."""
    begun: list[int] = []
    reset = World.reset

    def noted(world: World, *args: Any, **options: Any) -> None:
        reset(world, *args, **options)
        begun.extend(start for _, start in world.places)

    monkeypatch.setattr(World, "reset", noted)
    return begun
