"""Absences count the frames of the episode, and the clean output is that of those who are present."""

from __future__ import annotations

import pytest
import torch

from cp_env.world.scene_cache import SceneBank
from cp_env.world.world import World


def no_perturbation(world: World) -> torch.Tensor:
    return torch.zeros((world.num_envs, world.settings.k, *world.current().received.shape[2:]))


@pytest.mark.parametrize("start", [0, 1, 3])
def test_absent_frames_are_those_of_the_episode_wherever_it_starts(bank: SceneBank, start: int) -> None:
    world = World(1, defender="none", bank=bank, max_frames=6)
    world.reset([0], options={"start": start, "absent": {1: [0], 2: [2]}})
    there = []
    for _ in range(3):
        there.append(torch.nonzero(world.current().present[0]).flatten().tolist())
        world.step(no_perturbation(world))
    assert there == [[0, 2, 3, 4], [0, 1, 2, 3, 4], [0, 1, 3, 4]]


def test_the_clean_output_is_that_of_those_present(bank: SceneBank) -> None:
    """World by world, whoever is away: what was stored is of everyone, and the rest is perceived anew."""
    world = World(4, defender="none", bank=bank, max_frames=6)
    absences = [{}, {1: [0]}, {1: [0], 2: [0]}, {i: [0] for i in range(1, 5)}]
    same = {"scene": "toy-1", "start": 2}
    world.reset([0] * 4, options=[{**same, "absent": absent} for absent in absences])
    situation = world.current()
    with torch.inference_mode():
        expected = situation.ego_detector().perceive(
            situation.received, situation.coverage, torch.arange(4), situation.present
        )
    for e, (logits, boxes) in enumerate(zip(situation.clean.logits, situation.clean.boxes, strict=True)):
        rounding = 1e-4 if e else 1e-2  # what was stored went through half precision
        torch.testing.assert_close(logits, expected.logits[e], atol=rounding, rtol=rounding)
        torch.testing.assert_close(boxes, expected.boxes[e], atol=rounding, rtol=rounding)
        if e:
            assert (logits - situation.clean.logits[0]).abs().max() > 0.05
