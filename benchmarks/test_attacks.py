"""Attacks on one torch thread: PGD against the bare passes it is made of (at least 0.85 of their speed), and PPO."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest
import torch
from pytest_benchmark.fixture import BenchmarkFixture

import agents
from agents.sb3 import AdversaryVecEnv, make_vec_env
from cp_env.world import Situation, World

WORLDS = 4


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def situation() -> Situation:
    """The second frame of four worlds on test scenes, the first in which anyone may lie."""
    world = World(WORLDS, defender="none", scenes="town/test")
    world.reset([0] * WORLDS)
    world.step(torch.zeros(WORLDS, 2, *world.situation().received.shape[2:]))
    return world.situation()


def _bare(situation: Situation, passes: int) -> None:
    """The network alone: fuse, decode, and back to the maps."""
    rows, groups = torch.arange(WORLDS), torch.ones_like(situation.fused)
    received = situation.received.clone().requires_grad_()
    for _ in range(passes):
        dense = situation.detector.perceive(received, situation.coverage, rows, groups)
        torch.autograd.grad(dense.logits.sum() + dense.boxes.sum(), received)


def _seconds(work: Callable[[], object], rounds: int = 5) -> float:
    work()
    taken = []
    for _ in range(rounds):
        start = time.perf_counter()
        work()
        taken.append(time.perf_counter() - start)
    return min(taken)


def _attack(situation: Situation) -> torch.Tensor:
    attacker = agents.make("pgd")
    attacker.reset(WORLDS, np.random.default_rng(0))
    return attacker.act(situation)


def test_fifteen_steps_of_pgd_on_four_worlds(benchmark: BenchmarkFixture, situation: Situation) -> None:
    benchmark(_attack, situation)


def test_pgd_costs_little_more_than_its_forward_and_backward_passes(situation: Situation) -> None:
    share = _seconds(lambda: _bare(situation, passes=15)) / _seconds(lambda: _attack(situation))
    assert share >= 0.85, f"PGD runs at {share:.2f} of the speed of 15 bare forward and backward passes"


@pytest.mark.parametrize("worlds", [1, 8, 16])
def test_a_frame_of_the_vecenv(benchmark: BenchmarkFixture, worlds: int) -> None:
    env: AdversaryVecEnv = make_vec_env(worlds, "prbi", scenes="town/test")
    env.seed(0)
    env.reset()
    rng = np.random.default_rng(0)
    benchmark(lambda: env.step(rng.uniform(-1, 1, (env.num_envs, 8)).astype(np.float32)))
    benchmark.extra_info["frames per second"] = worlds / benchmark.stats["mean"] if benchmark.stats else None
