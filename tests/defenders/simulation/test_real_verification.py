"""Verification in the world and in the simulated one agree about every defender."""

from __future__ import annotations

import numpy as np
import pytest

import defenders
from cp_env.types import Detections, View
from cp_env.world.verification import Frame, judge
from defenders.simulation.world import SimulatedWorld

ATTACKERS = frozenset({1, 4})
FRAMES = 8


def view(group: frozenset[int], frame: int) -> View:
    """View of one car at a fixed place. An attacker hides it and adds a ghost where no other view has one."""
    benign = frame == 0 or ATTACKERS.isdisjoint(group)
    number = sum(1 << i for i in group) * FRAMES + frame
    x, y = (8.0, 3.0) if benign else (-30.0 + 3.5 * (number % 17), -30.0 + 1.5 * (number // 17))
    found = Detections(np.array([[x, y, 4.5, 1.9, 0.2]]), np.array([0.9]))
    score_map = np.zeros((64, 64))
    score_map[int(y) + 32, int(x) + 32] = 0.9
    return View(group, frame, np.zeros(2), found, found, score_map)


@pytest.mark.parametrize("name", defenders.names())
@pytest.mark.parametrize("seed", range(5))
def test_same_verdicts_and_same_count(name: str, seed: int) -> None:
    pair = [defenders.make(name), defenders.make(name)]
    for defender in pair:
        if (reveal := getattr(defender, "reveal_attackers", None)) is not None:
            reveal(ATTACKERS)
        defender.reset(5, np.random.default_rng(seed))
    world = SimulatedWorld(5, ATTACKERS)
    for t in range(FRAMES):
        expected = world.judge(pair[0], attack=t > 0)
        seen = view(frozenset(range(5)), t)
        (got,) = judge([Frame(t, 5, seen)], [pair[1]], lambda pairs, t=t: [view(group, t) for _, group in pairs])
        assert got.error is None
        assert (got.verdict, got.groups, got.verifications) == (
            expected.verdict,
            expected.groups,
            expected.verifications,
        )
