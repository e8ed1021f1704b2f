"""Uniform random actions through an action map: the behaviour of an untrained agent, or the middle of the map."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from torch import Tensor

from agents.protocol import Streams, streams
from cp_env.envs.actions.base import ActionMap
from cp_env.envs.actions.registry import make_action
from cp_env.settings import Precision
from cp_env.world.situation import Situation


@dataclass
class RandomActions:
    """Draws every number of every attacker's action anew each frame, from U[-reach, reach].

    Args:
        action: name of the action map.
        reach: half the width of the distribution, 0 to 1. With 0 every number is the middle of its range, which is what
            the mean of a policy is before it learns.
        gradient_precision: of the gradients that the map takes, "bfloat16" for faster ones; the victim's by default.

    Raises:
        ValueError: a reach out of range.
    """

    action: str = "guided"
    reach: float = 1.0
    gradient_precision: Precision | None = None
    _map: ActionMap | None = field(default=None, init=False, repr=False)
    _streams: list[np.random.Generator] = field(default_factory=list, init=False, repr=False)

    def __post_init__(self) -> None:
        if not 0 <= self.reach <= 1:
            raise ValueError(f"reach is half the width of the numbers' distribution, 0 to 1, not {self.reach}")

    def reset(self, n_worlds: int, rng: Streams) -> None:
        self._map, self._streams = None, streams(n_worlds, rng)

    def act(self, situation: Situation) -> Float[Tensor, "E k C H W"]:
        """See `Attack.act`."""
        if self._map is None:
            self._map = make_action(self.action, *situation.delta_shape[2:4], self.gradient_precision)
        shape = (situation.attackers.shape[1], *self._map.space.shape)
        actions = np.stack([rng.uniform(-self.reach, self.reach, shape) for rng in self._streams])
        return self._map(actions.astype(np.float32), situation)
