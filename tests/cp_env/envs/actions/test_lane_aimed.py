"""The aim of a `critical` action: ahead of the ego and to its left, wherever it faces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from cp_env.envs.actions.registry import make_action
from cp_env.world.scene_cache import SceneBank
from tests.cp_env.envs.actions.test_guided import DRIFT, SPOOF, WIDTH, E, K, X, Y, situation

FLOOR = 8


def played(bank: SceneBank, heading: float, numbers: dict[int, float], name: str = "critical") -> torch.Tensor:
    """δ of every slot with the same numbers, in a world whose egos face that way; no floor."""
    here = replace(situation(bank), heading=np.full(E, heading))
    actions = np.zeros((E, K, 9), dtype=np.float32)
    actions[..., FLOOR] = 1.0
    for number, value in numbers.items():
        actions[..., number] = value
    return make_action(name, 128, 32)(actions, here)


def landed(bank: SceneBank, delta: torch.Tensor) -> tuple[float, float]:
    """Mean column and row of the perturbation in the ego's frame: east and north."""
    here = situation(bank)
    poses = here.ego_T_sender.gather(1, here.attackers[..., None].expand(-1, -1, 3))
    cells = here.detector.warp(delta, poses).abs().mean((0, 1, 2))
    number = torch.arange(32)
    return tuple(float((cells.sum(axis) * number).sum() / cells.sum()) for axis in (0, 1))  # type: ignore[return-value]


def test_an_ego_that_faces_east_is_attacked_as_by_stealth_with_other_numbers(bank: SceneBank) -> None:
    """Hide only; 12 m ahead and 8 m to the right; 4 m wide."""
    mine = played(bank, 0.0, {X: 0.25, Y: -0.5, WIDTH: -0.5})
    theirs = {SPOOF: -1.0, DRIFT: -1.0, X: 12 / 32, Y: -8 / 32, WIDTH: -2.0}
    assert torch.equal(mine, played(bank, 0.0, theirs, "stealth"))
    assert mine.any()


@pytest.mark.parametrize(("heading", "axis", "sign"), [(0.0, 0, 1), (np.pi, 0, -1), (np.pi / 2, 1, 1)], ids=str)
def test_ahead_is_where_the_ego_faces(bank: SceneBank, heading: float, axis: int, sign: int) -> None:
    ahead, behind = (landed(bank, played(bank, heading, {X: x, WIDTH: -1.0}))[axis] for x in (0.6, -0.6))
    assert sign * (ahead - behind) > 3


def test_left_is_a_quarter_turn_from_ahead(bank: SceneBank) -> None:
    left, right = (landed(bank, played(bank, 0.0, {Y: y, WIDTH: -1.0}))[1] for y in (0.6, -0.6))
    assert left - right > 3
