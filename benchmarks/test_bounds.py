"""The network beside the processor, and the search of `guided` beside the network:

    python -m pytest -s benchmarks/test_bounds.py --benchmark-only

One core cannot do more multiply-adds a second than a large matrix product does, so the decoder's are compared with as
many of a product. Processor time of one thread, each pair in turn.
"""

from __future__ import annotations

import numpy as np
import pytest
import torch
from pytest_benchmark.fixture import BenchmarkFixture

from benchmarks.in_turn import InTurn, in_turn
from benchmarks.test_world import bank
from cp_env.detector import Detector
from cp_env.envs.actions.guided import Guided
from cp_env.settings import PRECISIONS
from cp_env.world.world import World

VIEWS = 16
MULTIPLY_ADDS = 84.9e6
"""Of the decoder, a view."""
SIDE = 1152
MOST = {"float32": 2.0, "bfloat16": 4.0}
"""Ratios to the matrix product that fail: well above what docs/speed.md gives."""
MOST_GUIDED = {"float32": 2.2, "bfloat16": 3.8}
"""The same of `guided` to its forward and backward passes. Where matrix units make the passes in bfloat16 quick, the
changes of δ, which are in single precision, weigh more."""


def decoder(precision: str) -> tuple[Detector, torch.Tensor]:
    """The network, and fused maps."""
    detector = bank(precision).detector
    assert isinstance(detector, Detector)
    maps = torch.rand(VIEWS, 128, 32, 32, generator=torch.Generator().manual_seed(0))
    return detector, maps.to(detector.dtype)


def passes(detector: Detector, maps: torch.Tensor, times: int = 1) -> None:
    """Forward and backward, to the maps alone: no weight has a gradient."""
    for _ in range(times):
        leaf = maps.detach().requires_grad_()
        dense = detector.decode(leaf)
        torch.autograd.grad(dense.logits.sum() + dense.boxes.sum(), leaf)


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("backward", [False, True])
def test_the_decoder_against_a_matrix_product(benchmark: BenchmarkFixture, backward: bool, precision: str) -> None:
    detector, maps = decoder(precision)
    rows = round(MULTIPLY_ADDS * VIEWS / SIDE**2) * (1 + backward)
    a, b = torch.ones(rows, SIDE).to(detector.dtype), torch.ones(SIDE, SIDE).to(detector.dtype)

    def network() -> None:
        if backward:
            return passes(detector, maps)
        with torch.inference_mode():
            detector.decode(maps)
        return None

    found = benchmark.pedantic(in_turn, args=(network, lambda: a @ b), kwargs={"rounds": 9}, rounds=1)
    said(f"{'forward and backward' if backward else 'forward'}, {precision}", found, VIEWS)
    assert found.ratio < MOST[precision]


@pytest.mark.parametrize("precision", PRECISIONS)
def test_guided_against_its_passes(benchmark: BenchmarkFixture, precision: str) -> None:
    """All attackers of 16 worlds fire; the bound is three passes of the network, forward and backward, a world."""
    detector, maps = decoder(precision)
    world = World(VIEWS, defender="none", bank=bank(precision), grace_frames=0, max_frames=4)
    world.reset(list(range(VIEWS)))
    situation, guided = world.current(), Guided(128, 32)
    actions = np.random.default_rng(0).uniform(-1, 1, (VIEWS, 2, 8)).astype(np.float32)
    actions[..., 7] = 1.0
    found = benchmark.pedantic(
        in_turn,
        args=(lambda: guided(actions, situation), lambda: passes(detector, maps, Guided.steps)),
        kwargs={"rounds": 5},
        rounds=1,
    )
    said(f"guided, {precision}", found, VIEWS)
    assert found.ratio < MOST_GUIDED[precision]


def said(what: str, found: InTurn, units: int) -> None:
    """Print a row of docs/speed.md's table."""
    work, bound = found.each(units)
    print(f"\n{what}: {work:.2f} ms, bound {bound:.2f}: {found.ratio:.2f}")
