"""The interface of action maps."""

from __future__ import annotations

from abc import ABC, abstractmethod

import gymnasium
import numpy as np
from jaxtyping import Float
from torch import Tensor

from cp_env.world.situation import Situation


class ActionMap(ABC):
    """The action space of a slot, and the map from all slots' actions to perturbations."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.space = gymnasium.spaces.Box(-1.0, 1.0, shape, np.float32)

    def reset(self, worlds: list[int]) -> None:  # noqa: B027 (most maps carry nothing over)
        """Discard what was carried over from frame to frame in `worlds`, where new episodes begin."""

    def checked(self, actions: np.ndarray, n: tuple[int, int]) -> Float[np.ndarray, "E k *a"]:
        """The actions of n = (E, k) slots, clipped to [-1, 1]; ValueError for a wrong shape, NaN or infinity."""
        array = np.asarray(actions, dtype=np.float32)
        shape = (*n, *self.space.shape)
        if array.shape != shape:
            raise ValueError(f"an action must have shape {self.space.shape}; together {shape}, not {array.shape}")
        if not np.isfinite(array).all():
            raise ValueError("an action must be finite, but it holds NaN or infinity; check the policy")
        return np.clip(array, -1.0, 1.0)

    @abstractmethod
    def __call__(self, actions: Float[np.ndarray, "E k *a"], situation: Situation) -> Float[Tensor, "E k C H W"]:
        """The perturbations, inside the ball, in the senders' grid frames."""
