"""The ninth number of a stealth action: a floor under the similarity of the ego's view."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from cp_env.envs.actions.registry import make_action
from cp_env.world.counterfactual import similarities, views_under
from cp_env.world.scene_cache import SceneBank
from cp_env.world.world import World

E, K = 2, 2


def play(bank: SceneBank, floor: float, frames: int = 4) -> tuple[np.ndarray, np.ndarray, float]:
    """How similar what the egos saw was to what they saw before, frame by frame; how similar it would have been with
    the perturbation of the frame before; and the damage of the last frame."""
    world = World(E, bank=bank, attackers=(1, 2), max_frames=frames + 1, defender="none")
    world.reset([0, 1])
    action_map, actions = make_action("stealth", 128, 32), np.zeros((E, K, 9), dtype=np.float32)
    actions[..., 8] = 1 - 2 * floor
    seen, again, damage, delta = [], [], 0.0, None
    everyone = [(e, frozenset(range(5))) for e in range(E)]
    for _ in range(frames):
        here = world.situation()
        before, delta = delta, action_map(actions, here)
        if before is not None:
            for found, perturbation in ((seen, delta), (again, before)):
                found.append(similarities(views_under(here, perturbation, everyone), list(here.output)))
        damage = float(world.step(delta).damage.mean())
    return np.array(seen), np.array(again), damage


@pytest.mark.parametrize("floor", [0.3, 0.6])
def test_the_view_stays_as_similar_as_the_floor_says(bank: SceneBank, floor: float) -> None:
    """Or as similar as it would have been if nothing had been changed."""
    seen, again, damage = play(bank, floor)
    assert (seen >= np.minimum(floor, again)).all()
    assert damage > 0.1


def test_a_lower_floor_does_more_damage(bank: SceneBank) -> None:
    assert play(bank, 0.1)[2] > play(bank, 0.8)[2]


def test_without_a_floor_it_is_the_guided_attack(bank: SceneBank) -> None:
    world = World(E, bank=bank, attackers=(1, 2), max_frames=4, defender="none", grace_frames=0)
    world.reset([0, 1])
    here = world.situation()
    stealth, guided = np.zeros((E, K, 9), dtype=np.float32), np.zeros((E, K, 8), dtype=np.float32)
    stealth[..., 8] = 1
    guided[..., [0, 5, 6]] = 1
    assert torch.equal(make_action("stealth", 128, 32)(stealth, here), make_action("guided", 128, 32)(guided, here))
    stealth[..., 7] = -1
    assert not make_action("stealth", 128, 32)(stealth, here).any()
