"""A situation that was handed out and overwritten leaves the world's own, and the next one, as they were."""

from __future__ import annotations

import numpy as np
import torch

from cp_env.world.scene_cache import SceneBank
from cp_env.world.situation import Situation
from cp_env.world.world import World
from tests.cp_env.world.test_handed_out import arrays, vandalise


def contents(situation: Situation) -> list[tuple[str, np.ndarray]]:
    found = [*arrays(situation), ("features", situation.features())]
    return [(name, thing.numpy().copy() if isinstance(thing, torch.Tensor) else thing.copy()) for name, thing in found]


def test_the_worlds_own_situation_and_the_next_one_stay(bank: SceneBank) -> None:
    world = World(2, defender="none", bank=bank, attackers=(1, 3), grace_frames=0, max_frames=3)
    world.reset([0, 1], options=[{}, {"absent": {2: [0, 1]}}])
    for _ in range(2):
        before = contents(world.current())
        assert {".clean.logits", ".clean[0]"} & {name for name, _ in before}
        handed = world.situation()
        handed.features().zero_()
        vandalise(handed)
        for situation in (world.current(), world.situation()):
            for (name, old), (_, new) in zip(before, contents(situation), strict=True):
                np.testing.assert_array_equal(old, new, err_msg=name)
        world.step(torch.ones((2, 2, *world.current().received.shape[2:])))
