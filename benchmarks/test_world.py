"""A frame of a verified world against the bare network: `python -m pytest benchmarks/test_world.py --benchmark-only`.

Each frame of each world takes three views (everyone and two groups, one of which is the output), as PRBI does under
attack. The bare forward fuses and decodes the same views in one batch and makes no boxes of them.
"""

from __future__ import annotations

import numpy as np
import pytest
import torch
from pytest_benchmark.fixture import BenchmarkFixture

from cp_env.detector import load_detector
from cp_env.world.scene_cache import SceneBank
from cp_env.world.world import World
from defenders.protocol import Defender, Frame, Inspection, Query, Verdict
from tests.helpers.toy_scenes import ToySource


class TwoGroups(Defender):
    """Splits the fleet anew in every frame and fuses the part more like the frame before."""

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        self.n, self.rng, self.last = n_vehicles, rng, None

    def inspect(self, frame: Frame) -> Inspection:
        order = self.rng.permutation(self.n)
        views = yield Query([order[:2], order[2:]])
        last = self.last or frame.seen
        scores = [frame.similarity(view, last) for view in (frame.seen, *views)]
        best = int(np.argmax(scores[1:]))
        self.last = views[best]
        return Verdict([order[:2], order[2:]][best])


@pytest.fixture(scope="module")
def bank() -> SceneBank:
    return SceneBank(ToySource(n_frames=12), load_detector(), progress=False)


def played(bank: SceneBank, num_envs: int) -> World:
    world = World(num_envs, defender=TwoGroups(), bank=bank, max_frames=12)
    world.reset(list(range(num_envs)))
    return world


@pytest.mark.parametrize("num_envs", [1, 16])
def test_bare_forward_of_three_views_a_world(benchmark: BenchmarkFixture, bank: SceneBank, num_envs: int) -> None:
    here = played(bank, num_envs).situation()
    rows = torch.arange(num_envs).repeat(3)
    groups = torch.tensor([[1, 1, 1, 1, 1], [1, 1, 0, 0, 0], [0, 0, 1, 1, 1]]).bool().repeat_interleave(num_envs, 0)
    with torch.inference_mode():
        benchmark(here.detector.perceive, here.received, here.coverage, rows, groups)


@pytest.mark.parametrize("num_envs", [1, 16])
def test_step_of_three_views_a_world(benchmark: BenchmarkFixture, bank: SceneBank, num_envs: int) -> None:
    world = played(bank, num_envs)
    delta = torch.zeros(num_envs, 2, 128, 32, 32)

    def fresh() -> None:
        world.reset()

    benchmark.pedantic(world.step, args=(delta,), setup=fresh, rounds=20, warmup_rounds=2)
