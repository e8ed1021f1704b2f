"""Laws of every action map."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

import cp_env
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


@pytest.mark.parametrize("name", ["guided", "stealth", "critical"])
def test_a_search_in_bfloat16_finds_much_the_same_and_leaves_the_victim_alone(bank: SceneBank, name: str) -> None:
    here = situation(bank)
    actions = np.zeros((E, K, *make_action(name, 128, 32).space.shape), dtype=np.float32)
    exact, rounded = (make_action(name, 128, 32, one)(actions, here) for one in (None, "bfloat16"))
    assert here.received.dtype == torch.float32 and here.detector is bank.detector
    assert not torch.equal(exact, rounded)
    assert torch.cosine_similarity(exact.flatten(), rounded.flatten(), dim=0) > 0.5  # signs of faint slopes are luck


@pytest.mark.parametrize("name", ["basis", "full"])
def test_a_precision_without_a_gradient_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match=rf"take a gradient \(guided, stealth, critical\), not for '{name}'"):
        make_action(name, 128, 32, "bfloat16")


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ({"action": "basis", "gradient_precision": "bfloat16"}, "not for 'basis'"),
        ({"gradient_precision": "bfloat61"}, "bfloat16"),
        (
            {"detector": "tests.cp_env.detector.model.test_precision:Plain", "gradient_precision": "bfloat16"},
            "knows no",
        ),
        ({"precision": "bfloat16", "gradient_precision": "float32"}, "open the detector anew"),
    ],
)
def test_environments_refuse_precisions_that_cannot_be_had(options: dict[str, Any], what: str) -> None:
    with pytest.raises(ValueError, match=what):
        cp_env.parallel_env(**options)
