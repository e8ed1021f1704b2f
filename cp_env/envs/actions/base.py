"""The interface of action maps."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import gymnasium
import numpy as np
from jaxtyping import Float
from torch import Tensor

from cp_env.world.situation import Situation
from defenders.registry import shown

LARGEST = 1 << 28
"""Numbers of an action, at most: a thousand worlds of five whole maps of 64 by 64 cells have fewer."""


def real_numbers(action: object, what: str = "an action") -> Float[np.ndarray, "..."]:
    """An action as an array of single precision.

    Args:
        action: an array, a tensor without a graph, or nested sequences of real numbers.
        what: what it is called in messages.

    Returns:
        A new array; its shape is for the caller to check.

    Raises:
        ValueError: it holds anything else: text, complex numbers, masked entries, numbers too large for any float, or
            more numbers than any action has.
    """
    parts = action if isinstance(action, list | tuple) else ()
    if isinstance(action, str | bytes | np.ma.MaskedArray) or any(isinstance(p, np.ma.MaskedArray) for p in parts):
        raise ValueError(f"{what} must hold real numbers, not {type(action).__name__}")
    if any(isinstance(part, Sequence) and len(part) > LARGEST for part in (action, *parts)):  # such as a long range
        raise ValueError(f"{what} must hold at most {LARGEST} numbers")
    try:
        array = np.asarray(action)
    except Exception as error:  # whatever an object of others raises, it is no action
        raise ValueError(f"{what} must hold real numbers and no graph: {shown(str(error), 200)}") from error
    if array.dtype.kind not in "fiub":
        raise ValueError(f"{what} must hold real numbers, not {array.dtype}")
    if array.size > LARGEST:
        raise ValueError(f"{what} must hold at most {LARGEST} numbers, not {array.size}")
    with np.errstate(over="ignore"):  # what is too large becomes infinite, which is refused by `checked`
        return array.astype(np.float32)


class ActionMap(ABC):
    """The action space of a slot, and the map from all slots' actions to perturbations."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.space = gymnasium.spaces.Box(-1.0, 1.0, shape, np.float32)

    def reset(self, worlds: list[int]) -> None:  # noqa: B027 (most maps carry nothing over)
        """Discard what was carried over from frame to frame in `worlds`, where new episodes begin."""

    def checked(self, actions: object, n: tuple[int, int]) -> Float[np.ndarray, "E k *a"]:
        """The actions of n = (E, k) slots, clipped to [-1, 1]; ValueError for a wrong shape, NaN or infinity."""
        array = real_numbers(actions)
        shape = (*n, *self.space.shape)
        if array.shape != shape:
            raise ValueError(f"an action must have shape {self.space.shape}; together {shape}, not {array.shape}")
        if not np.isfinite(array).all():
            raise ValueError("an action must be finite, but it holds NaN or infinity; check the policy")
        return np.clip(array, -1.0, 1.0)

    @abstractmethod
    def __call__(self, actions: Float[np.ndarray, "E k *a"], situation: Situation) -> Float[Tensor, "E k C H W"]:
        """The perturbations, inside the ball, in the senders' grid frames."""
