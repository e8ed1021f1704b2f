"""The interface of an attack: from the situation of all worlds to what the attackers add to their maps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float
from torch import Tensor

from cp_env.world.situation import Situation

Streams = np.random.Generator | Sequence[np.random.Generator]


@runtime_checkable
class Attack(Protocol):
    """A scripted attack: it controls the attackers of E worlds at once.

    The ego's detector is frozen: an attack never changes it.
    """

    def reset(self, n_worlds: int, rng: Streams) -> None:
        """Begin new episodes in all worlds. All randomness must come from `rng`: one stream, or one for each world."""
        ...

    def act(self, situation: Situation) -> Float[Tensor, "E k C H W"]:
        """δ of every attacker, in its sender's frame, inside the budget."""
        ...


@runtime_checkable
class Learned(Protocol):
    """A learned attack: from the observations of an environment made with `options` to its actions."""

    @property
    def options(self) -> Mapping[str, Any]:
        """The options of the environment it was trained in."""
        ...

    def __call__(self, observations: Any) -> Float[np.ndarray, "E k a"]:
        """The action of every attacker."""
        ...
