"""One joint adversary in place of many slots: slot arrays are concatenated along their first axis.

A slot's (A,) becomes (S·A,), its (C, H, W) becomes (S·C, H, W); every array of a Dict likewise.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import Space, spaces
from numpy.typing import NDArray

from cp_env.settings import Options

Observation = NDArray[Any] | dict[str, NDArray[Any]]


def joint_options(options: Options) -> Options:
    """The options of a joint view: compact observations by default, slots for adversaries.

    Raises:
        ValueError: `slots` is given; one adversary drives all attackers here.
    """
    if "slots" in options:
        raise ValueError("slots has no meaning where one joint adversary drives all attackers; leave it out")
    return {"observation": "compact", **options, "slots": "adversaries"}


def joint_space(space: Space[Any], n_slots: int) -> Space[Any]:
    """The space of `n_slots` slots concatenated; `space` is a Box of one axis or more, or a Dict of such."""
    if isinstance(space, spaces.Dict):
        return spaces.Dict({key: joint_space(part, n_slots) for key, part in space.items()})
    assert isinstance(space, spaces.Box) and space.shape
    low, high = (np.concatenate([bound] * n_slots) for bound in (space.low, space.high))
    return spaces.Box(low, high, dtype=space.dtype.type)


def join(observations: Observation) -> Observation:
    """(E, S, a, …) → (E, S·a, …), in fresh arrays."""
    if isinstance(observations, dict):
        return {key: _join(part) for key, part in observations.items()}
    return _join(observations)


def _join(array: NDArray[Any]) -> NDArray[Any]:
    n_worlds, n_slots, first, *rest = array.shape
    return array.reshape(n_worlds, n_slots * first, *rest).copy()


def split(actions: NDArray[Any], n_slots: int) -> NDArray[Any]:
    """(E, S·a, …) → (E, S, a, …)."""
    n_worlds, first, *rest = actions.shape
    return actions.reshape(n_worlds, n_slots, first // n_slots, *rest)


def world(observations: Observation, index: int) -> Observation:
    """The observation of one world out of a batch (E, …), in fresh arrays."""
    if isinstance(observations, dict):
        return {key: part[index].copy() for key, part in observations.items()}
    return observations[index].copy()
