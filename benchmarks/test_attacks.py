"""Attacks on one torch thread: PGD against the bare passes it is made of (at least 0.85 of their speed), and PPO."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
import pytest
import torch
from pytest_benchmark.fixture import BenchmarkFixture

import agents
from agents.attacks.objectives.untargeted import UntargetedObjective
from agents.attacks.targets import attack_loss, collect_targets, everyone
from agents.sb3 import AdversaryVecEnv, make_vec_env
from cp_env.world.situation import Situation
from cp_env.world.world import World

STEPS = 15


@lru_cache
def situation(worlds: int, fusion: str) -> Situation:
    """The second frame of a test scene, the first that can be attacked; attackers drawn for each world."""
    world = World(worlds, defender="none", scenes="town/test", fusion=fusion)
    world.reset(list(range(worlds)), options={"scene": world.bank.source.names()[0]})
    world.step(torch.zeros(worlds, 2, *world.situation().received.shape[2:]))
    return world.situation()


def bare(here: Situation) -> None:
    """The network alone: fuse and decode all maps, and back to all of them."""
    rows, groups = torch.arange(len(here.fused)), torch.ones_like(here.fused)
    received = here.received.clone().requires_grad_()
    for _ in range(STEPS):
        dense = here.detector.perceive(received, here.coverage, rows, groups)
        torch.autograd.grad(dense.logits.sum() + dense.boxes.sum(), received)


def attackers_only(here: Situation) -> None:
    """The same from and to the attackers' δ alone, warped; by mean fusion the benign are fused once for all."""
    perceive = collect_targets(here, everyone, here.active, joint=True).perceive()
    delta = torch.zeros(*here.attackers.shape, *here.received.shape[2:], requires_grad=True)
    for _ in range(STEPS):
        dense = perceive(delta)
        torch.autograd.grad(dense.logits.sum() + dense.boxes.sum(), delta)


def pgd(here: Situation) -> None:
    attack = agents.make("pgd", steps=STEPS)
    attack.reset(len(here.active), np.random.default_rng(0))
    attack.act(here)


def seconds(works: Sequence[Callable[[Situation], None]], here: Situation, rounds: int) -> list[float]:
    """CPU seconds of each work, the least of several rounds taken in turn: other programs slow all of them equally."""
    taken: list[list[float]] = []
    for _ in range(rounds + 1):  # the first warms up
        taken.append([])
        for work in works:
            start = time.process_time()
            work(here)
            taken[-1].append(time.process_time() - start)
    return np.min(taken[1:], axis=0).tolist()


@pytest.mark.parametrize("worlds", [1, 16])
@pytest.mark.parametrize("fusion", ["mean", "disconet"])
def test_fifteen_steps_of_pgd(benchmark: BenchmarkFixture, fusion: str, worlds: int) -> None:
    benchmark.pedantic(pgd, (situation(worlds, fusion),), rounds=3, warmup_rounds=1)
    if benchmark.stats:
        benchmark.extra_info["steps per second"] = worlds * STEPS / benchmark.stats["mean"]


@pytest.mark.parametrize("worlds", [1, 16])
@pytest.mark.parametrize("fusion", ["mean", "disconet"])
def test_pgd_costs_little_more_than_its_forward_and_backward_passes(fusion: str, worlds: int) -> None:
    network, through, attack = seconds(
        (bare, attackers_only, pgd), situation(worlds, fusion), rounds=12 if worlds == 1 else 4
    )
    speed = f"{worlds * STEPS / attack:.0f} steps per CPU second"
    print(f"\n{fusion}, {worlds} worlds: {speed}, {network / attack:.2f} of bare passes' speed, ", end="")
    print(f"{through / attack:.2f} of that of passes through the attackers' maps alone")
    assert network / attack >= 0.85


def test_pgd_against_foolbox() -> None:
    """The same fifteen steps from the same start on the same network, by Foolbox's loop (see `make attacks`)."""
    pytest.importorskip("foolbox", reason="pip install -e '.[attacks-check]'")
    from tests.external.foolbox_twin import foolbox_attack

    def theirs(here: Situation) -> None:
        loss = attack_loss(collect_targets(here, everyone, here.active, joint=True), UntargetedObjective())
        start = torch.zeros(*here.attackers.shape, *here.received.shape[2:])
        foolbox_attack("LinfPGD", loss, here, start=start, steps=STEPS, step_size=0.1)

    for worlds in (1, 16):
        ours, other = seconds((pgd, theirs), situation(worlds, "mean"), rounds=48 // (worlds + 3))
        speed = [worlds * STEPS / taken for taken in (ours, other)]
        print(f"\n{worlds} worlds: {speed[0]:.0f} steps per CPU second, Foolbox's loop {speed[1]:.0f}", end="")
        assert ours < 1.1 * other


@pytest.mark.parametrize("worlds", [1, 8, 16])
def test_a_frame_of_the_vecenv(benchmark: BenchmarkFixture, worlds: int) -> None:
    env: AdversaryVecEnv = make_vec_env(worlds, "prbi", scenes="town/test")
    env.seed(0)
    env.reset()
    rng = np.random.default_rng(0)
    benchmark(lambda: env.step(rng.uniform(-1, 1, (env.num_envs, 8)).astype(np.float32)))
    benchmark.extra_info["frames per second"] = worlds / benchmark.stats["mean"] if benchmark.stats else None
