"""Worlds and attackers of one batch are judged each by itself: whoever may not send, sends nothing."""

from __future__ import annotations

from typing import Any

import torch

from cp_env.world.scene_cache import SceneBank
from cp_env.world.transmission import transmit
from cp_env.world.world import World


def loud(world: World) -> torch.Tensor:
    return torch.full((world.num_envs, world.settings.k, *world.current().received.shape[2:]), 9.0)


def made(bank: SceneBank, num_envs: int, **options: Any) -> World:
    return World(num_envs, defender="none", bank=bank, attackers=(1, 3), budget=0.3, **options)


def test_a_world_in_grace_sends_nothing_while_another_does(bank: SceneBank) -> None:
    world = made(bank, 2, grace_frames=1)
    world.reset([0, 1])
    world.step(loud(world))
    world.reset([2], [0])
    situation, before = world.current(), world.situation().received
    norms = transmit(situation, loud(world), world.settings)
    assert situation.active.tolist() == [False, True]
    assert norms[0].tolist() == [0, 0] and (norms[1] > 0.29).all()
    assert torch.equal(before[0], situation.received[0])
    changed = (before[1] != situation.received[1]).flatten(1).any(1)
    assert changed.tolist() == [False, True, False, True, False]


def test_an_absent_attacker_sends_nothing_while_another_does(bank: SceneBank) -> None:
    for away, there in ((1, 3), (3, 1)):
        world = made(bank, 1, grace_frames=0)
        world.reset([0], options={"absent": {away: [0]}})
        situation, before = world.current(), world.situation().received
        norms = transmit(situation, loud(world), world.settings)
        assert [bool(norm) for norm in norms[0]] == [there == 1, there == 3]
        changed = (before[0] != situation.received[0]).flatten(1).any(1)
        assert torch.nonzero(changed).flatten().tolist() == [there]
