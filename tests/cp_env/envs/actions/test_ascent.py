"""The ascent by hand, and the short way through fused maps beside the plain one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from cp_env.detector.model.decoder import Dense
from cp_env.detector.model.warp import weighted_moves
from cp_env.envs.actions import ascent
from cp_env.envs.actions.registry import make_action
from cp_env.perturbation.output import LinearOutput
from cp_env.world.scene_cache import SceneBank
from cp_env.world.world import World
from tests.helpers import situations

SLOPE = torch.tensor([[[4.0, 0.03], [-4.0, -0.06]], [[0.0, -0.02], [1.0, 0.0]]])
"""Gradient of two channels of 2 by 2 cells; the strongest entries of the cells are 4, 0.03, 4 and 0.06."""


def decode(fused: torch.Tensor) -> Dense:
    """A decoder whose loss, the sum of its logits, has the gradient `SLOPE` everywhere."""
    return Dense((fused * SLOPE).sum(1), torch.zeros(len(fused), 6, 2, 2))


def linear(columns: int, share: float = 0.5) -> LinearOutput:
    """One world with one attacker, whose map lies so many columns of one of two cells east of the ego's."""
    pose = torch.tensor([[[32.0 * columns, 0.0, 0.0]]])
    shares = torch.full((1, 1, 1, 2, 2), share)
    moves = weighted_moves(shares, torch.tensor([0]), pose, 32.0)
    return LinearOutput(situations.detector(), decode, torch.zeros(1, 2, 2, 2), shares, pose, torch.tensor([0]), moves)


def climbed(perceive: LinearOutput, radius: float = 0.3, steps: int = 1) -> torch.Tensor:
    delta = torch.zeros(1, 1, 2, 2, 2)
    ascent.climb(delta, torch.tensor([[radius]]), perceive, lambda dense: dense.logits.sum((1, 2)), "linf", steps)
    return delta[0, 0]


def test_a_step_by_hand() -> None:
    """Signs times twice the radius, clipped; the cell of 0.03 is faint beside 0.01 · 4, that of 0.06 is not."""
    expected = torch.tensor([[[0.3, 0.0], [-0.3, -0.3]], [[0.0, 0.0], [0.3, 0.0]]])
    torch.testing.assert_close(climbed(linear(0)), expected)


def test_a_step_of_a_map_that_is_moved_by_hand() -> None:
    """The ego's right column comes from the sender's left one. The strongest there is 0.06, so 0.03 is not faint."""
    expected = torch.tensor([[[0.3, 0.0], [-0.3, 0.0]], [[-0.3, 0.0], [0.0, 0.0]]])
    torch.testing.assert_close(climbed(linear(1)), expected)


def test_several_steps_are_shorter_ones() -> None:
    torch.testing.assert_close(climbed(linear(0), steps=4) * (SLOPE[1, 1, 0] > 0), climbed(linear(0)))
    assert not climbed(linear(0), radius=0.0).any()


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_signs_of_fused_gradients_are_those_of_every_delta(
    bank: SceneBank, precision: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To the bit, with two attackers of several worlds, of whom one is silent; over frames that start from the last."""
    world = World(3, defender="none", bank=bank, n_attackers=2, grace_frames=0)
    world.reset([0, 1, 2])
    actions = np.random.default_rng(0).uniform(-1, 1, (3, 2, 8)).astype(np.float32)
    actions[..., 7] = 1.0
    actions[1, 0, 7] = -1.0
    short, found, calls = ascent._climb_fused, [], []

    def counted(delta: Any, radius: Any, perceive: Any, moves: Any, damage: Any, stride: float) -> None:
        calls.append("short" if len(found) == 0 else "plain")
        if calls[-1] == "short":
            short(delta, radius, perceive, moves, damage, stride)
        else:
            ascent._climb(delta, radius, perceive, damage, "linf", stride)

    monkeypatch.setattr(ascent, "_climb_fused", counted)
    for _ in range(2):
        steer = make_action("guided", bank.detector.channels, bank.detector.size, precision)
        found.append([steer(actions, world.current()).clone() for _ in range(2)])
    assert calls.count("short") == calls.count("plain") == 6
    assert all(torch.equal(a, b) for a, b in zip(*found, strict=True))
    assert found[0][1][1, 1].any() and not found[0][1][1, 0].any()
