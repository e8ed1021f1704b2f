"""A frame of a verified world beside its bare network: `python -m pytest -s benchmarks/test_world.py --benchmark-only`.

The work is all from `situation()` to `Outcome`: two attackers of every world send noise of full strength, everyone's
view is perceived, the defender asks for groups and compares their views, boxes are made of all of them. The bound is
the network alone: the same number of views fused and decoded in one call, no boxes made. Both in turn, processor time,
12 frames of `town/test`, one torch thread, freed memory kept.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
import torch
from pytest_benchmark.fixture import BenchmarkFixture

from agents.sb3 import make_vec_env
from benchmarks.in_turn import InTurn, in_turn
from cp_env.detector.registry import open_detector
from cp_env.scenes import open_source
from cp_env.settings import ACTIONS, PRECISIONS
from cp_env.world.allocator import keep_freed_memory
from cp_env.world.scene_cache import SceneBank
from cp_env.world.world import World
from defenders.protocol import Defender, Frame, Inspection, Query, Verdict

FRAMES = 12
MOST = {"float32": {1: 4.0, 16: 2.6, 64: 2.6}, "bfloat16": {1: 5.0, 16: 4.0, 64: 4.0}}
"""Ratios to the bare network that fail, by number of worlds: well above what docs/speed.md gives. A processor with
matrix units makes the network in bfloat16 several times as fast, and nothing else."""
MOST_LEARNER = {"guided": 16.0, "basis": 7.0}
"""The same for SB3's environment, by action map, over one bare view a frame."""


class Splits(Defender):
    """Parts the fleet anew `splits` times a frame, compares all parts with the last output, fuses the last."""

    def __init__(self, splits: int) -> None:
        self.splits = splits

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        self.n, self.rng, self.last = n_vehicles, rng, None

    def inspect(self, frame: Frame) -> Inspection:
        group, view = frozenset(range(self.n)), frame.seen
        for _ in range(self.splits):
            order = self.rng.permutation(self.n)
            parts = [order[:2], order[2:]]
            views = yield Query(parts)
            for one in views:
                frame.similarity(one, self.last or frame.seen)
            group, view = frozenset(parts[1].tolist()), views[1]
        self.last = view
        return Verdict(group)


@lru_cache(maxsize=1)
def bank(precision: str) -> SceneBank:
    keep_freed_memory()
    return SceneBank(open_source("town/test"), open_detector(precision=precision), progress=False)


def bare(world: World, views: int) -> object:
    """The network on the maps of the current frame: everyone, and parts of two and of three."""
    here, n = world.situation(), world.num_envs
    parts = torch.tensor([[1, 1, 1, 1, 1], [1, 1, 0, 0, 0], [0, 0, 1, 1, 1]]).bool()
    groups = parts[[0, *(1 + i % 2 for i in range(views - 1))]].repeat_interleave(n, 0)
    rows, maps = torch.arange(n).repeat(views), here.received
    with torch.inference_mode():
        return lambda: here.detector.perceive(maps, here.coverage, rows, groups)


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("views", [1, 3, 9])
@pytest.mark.parametrize("num_envs", [1, 16, 64])
def test_a_frame(benchmark: BenchmarkFixture, num_envs: int, views: int, precision: str) -> None:
    world = World(num_envs, defender=Splits((views - 1) // 2), bank=bank(precision), max_frames=FRAMES)
    world.reset(list(range(num_envs)))
    rng = np.random.default_rng(0)
    delta = torch.from_numpy(rng.uniform(-0.3, 0.3, world.current().delta_shape).astype(np.float32))
    network = bare(world, views)

    def episode() -> None:
        for _ in range(FRAMES):
            world.situation()
            world.step(delta)

    def networks() -> None:
        with torch.inference_mode():
            for _ in range(FRAMES):
                network()  # type: ignore[operator]

    def again() -> None:
        world.reset(list(range(num_envs)))

    found = benchmark.pedantic(
        in_turn, args=(episode, networks), kwargs={"setup": again, "rounds": 3, "warmup": 1}, rounds=1
    )
    said(benchmark, f"E = {num_envs}, {views} views, {precision}", found, num_envs * FRAMES)
    assert found.ratio < MOST[precision][num_envs]


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("num_envs", [8, 16])
@pytest.mark.parametrize("action", ACTIONS)
def test_a_frame_of_a_learner(benchmark: BenchmarkFixture, action: str, num_envs: int, precision: str) -> None:
    """SB3's environment against PRBI, random actions; the bound is the network on everyone's view once a frame."""
    env = make_vec_env(num_envs, "prbi", bank=bank(precision), action=action, max_frames=FRAMES)
    rng = np.random.default_rng(0)
    shape = (FRAMES, env.num_envs, *(env.action_space.shape or ()))
    actions = rng.uniform(-1, 1, shape).astype(np.float32)
    env.seed(0)
    env.reset()
    network = bare(env.game.world, 1)

    def episode() -> None:
        for one in actions:
            env.step(one)

    def networks() -> None:
        with torch.inference_mode():
            for _ in range(FRAMES):
                network()  # type: ignore[operator]

    def again() -> None:
        env.seed(0)
        env.reset()

    found = benchmark.pedantic(
        in_turn, args=(episode, networks), kwargs={"setup": again, "rounds": 3, "warmup": 1}, rounds=1
    )
    said(benchmark, f"{action}, {num_envs} worlds, {precision}", found, num_envs * FRAMES)
    assert found.ratio < MOST_LEARNER.get(action, np.inf)


def said(benchmark: BenchmarkFixture, what: str, found: InTurn, frames: int) -> None:
    """Print a row of docs/speed.md's tables."""
    work, bound = found.each(frames)
    benchmark.extra_info["ratio to the bare network"] = round(found.ratio, 2)
    print(f"\n{what}: {work:.2f} ms a world-frame ({1e3 / work:.0f} a second), network {bound:.2f}: {found.ratio:.2f}")
