"""Laws of every action map."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from cp_env.envs.actions.registry import make_action
from cp_env.perturbation.channel import norm_of
from cp_env.settings import ACTIONS
from cp_env.world.scene_cache import SceneBank
from tests.cp_env.envs.actions.test_guided import E, K, situation


@pytest.mark.parametrize("norm", ["linf", "l2"])
@pytest.mark.parametrize("name", ACTIONS)
def test_every_action_lands_in_the_ball_and_is_deterministic(bank: SceneBank, name: str, norm: str) -> None:
    rng = np.random.default_rng(0)
    here = situation(bank, norm)
    maps = [make_action(name, 128, 32) for _ in range(2)]
    for scale in (0.3, 1.0, 50.0):
        actions = maps[0].checked(rng.normal(0, scale, (E, K, *maps[0].space.shape)), (E, K))
        first, second = (m(actions, here) for m in maps)
        assert torch.equal(first, second)
        assert tuple(first.shape) == (E, K, 128, 32, 32)
        assert (norm_of(first, norm) <= here.budget * (1 + 1e-5)).all()


@pytest.mark.parametrize("name", ACTIONS)
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_actions_that_are_not_numbers_are_refused(name: str, bad: float) -> None:
    action_map = make_action(name, 4, 8)
    actions = np.zeros((E, K, *action_map.space.shape))
    actions[0, 1].flat[0] = bad
    with pytest.raises(ValueError, match="finite"):
        action_map.checked(actions, (E, K))


@pytest.mark.parametrize("name", ACTIONS)
def test_wrong_shapes_are_refused_and_large_values_clipped(name: str) -> None:
    action_map = make_action(name, 4, 8)
    with pytest.raises(ValueError, match="shape"):
        action_map.checked(np.zeros((E, K, 3)), (E, K))
    clipped = action_map.checked(np.full((E, K, *action_map.space.shape), 7.0), (E, K))
    assert (clipped == 1.0).all()
