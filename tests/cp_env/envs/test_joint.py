"""Slots laid end to end: by hand, and there and back."""

from __future__ import annotations

import numpy as np
import pytest
from gymnasium import spaces

from cp_env.envs.joint import join, joint_space, split, world


def test_two_slots_by_hand() -> None:
    observations = np.array([[[1, 2, 3], [4, 5, 6]]])  # one world, two slots of three numbers
    assert join(observations).tolist() == [[1, 2, 3, 4, 5, 6]]  # type: ignore[union-attr]
    assert split(np.array([[1, 2, 3, 4]]), 2).tolist() == [[[1, 2], [3, 4]]]


@pytest.mark.parametrize("shape", [(5,), (2, 3, 3)])
@pytest.mark.parametrize("n_slots", [1, 2, 4])
def test_what_was_joined_is_split_again(shape: tuple[int, ...], n_slots: int) -> None:
    slots = np.random.default_rng(0).normal(size=(3, n_slots, *shape))
    joined = join(slots)
    assert isinstance(joined, np.ndarray) and joined.shape == (3, n_slots * shape[0], *shape[1:])
    assert np.array_equal(split(joined, n_slots), slots)
    joined[:] = 0.0
    assert slots.all(), "what was handed out is the caller's own"


def test_a_joint_space_holds_what_is_joined_and_nothing_wider() -> None:
    low, high = np.array([-1.0, 0.0], np.float32), np.array([1.0, 3.0], np.float32)
    slot = spaces.Dict(maps=spaces.Box(0.0, 1.0, (2, 4, 4), np.float32), context=spaces.Box(low, high))
    joint = joint_space(slot, 3)
    assert isinstance(joint, spaces.Dict)
    maps, context = joint["maps"], joint["context"]
    assert isinstance(context, spaces.Box)
    assert context.low.tolist() == [-1, 0] * 3 and context.high.tolist() == [1, 3] * 3
    assert maps.shape == (6, 4, 4) and maps.dtype == np.float32
    slot.seed(0)
    drawn = [slot.sample() for _ in range(3)]
    batch = {key: np.stack([one[key] for one in drawn])[None] for key in slot}
    assert joint.contains(world(join(batch), 0))


def test_one_world_of_a_batch_is_a_copy() -> None:
    batch = {"context": np.arange(6.0).reshape(2, 3)}
    one = world(batch, 1)
    assert isinstance(one, dict) and one["context"].tolist() == [3, 4, 5]
    one["context"][:] = 9.0
    assert batch["context"].max() == 5.0
