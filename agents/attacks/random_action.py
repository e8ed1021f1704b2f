"""Uniform random actions through an action map: the behaviour of an untrained agent."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from torch import Tensor

from agents.protocol import Streams, streams
from cp_env.envs.actions.base import ActionMap
from cp_env.envs.actions.registry import make_action
from cp_env.world.situation import Situation


@dataclass
class RandomActions:
    """Draws every number of every attacker's action anew each frame, from U[-1, 1].

    Args:
        action: name of the action map.
    """

    action: str = "guided"
    _map: ActionMap | None = field(default=None, init=False, repr=False)
    _streams: list[np.random.Generator] = field(default_factory=list, init=False, repr=False)

    def reset(self, n_worlds: int, rng: Streams) -> None:
        self._map, self._streams = None, streams(n_worlds, rng)

    def act(self, situation: Situation) -> Float[Tensor, "E k C H W"]:
        """See `Attack.act`."""
        if self._map is None:
            self._map = make_action(self.action, *situation.delta_shape[2:4])
        shape = (situation.attackers.shape[1], *self._map.space.shape)
        actions = np.stack([rng.uniform(-1.0, 1.0, shape) for rng in self._streams])
        return self._map(actions.astype(np.float32), situation)
