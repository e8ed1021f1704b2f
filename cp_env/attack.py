"""The interface and base class of an attack: from the situation of all worlds to what the attackers add to their maps.

class Mine(agents.Attack):
    def act(self, situation):
        return torch.zeros(situation.delta_shape, device=situation.device)
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float
from torch import Tensor

from cp_env.world.situation import Situation
from defenders.registry import shown

Streams = np.random.Generator | Sequence[np.random.Generator]
"""What `Attack.reset` takes: a generator for each world, or one from which they are spawned."""


def streams(n_worlds: int, rng: object) -> list[np.random.Generator]:
    """One generator a world, so that a world's noise does not depend on its neighbours.

    Args:
        n_worlds: E.
        rng: `Streams`: one generator a world, kept as they are; or a single one, from which E are spawned.

    Returns:
        The generators, one a world.

    Raises:
        ValueError: another number of generators, or something that is none.
    """
    if isinstance(rng, np.random.Generator):
        return rng.spawn(n_worlds)
    if not isinstance(rng, Sequence) or not all(isinstance(one, np.random.Generator) for one in rng):
        raise ValueError(f"rng must be numpy generators, one a world, or a single one; got {shown(rng)}")
    if len(rng) != n_worlds:
        raise ValueError(f"one generator a world is needed: {n_worlds} worlds, {len(rng)} generators")
    return list(rng)


@runtime_checkable
class Attack(Protocol):
    """A scripted attack: it controls the attackers of E worlds at once.

    It is the base class of an attack of yours, which then needs `act` alone; any object with the two methods is an
    attack as well. The ego's detector is frozen: an attack never changes it.
    """

    def reset(self, n_worlds: int, rng: Streams) -> None:
        """Begin new episodes in all worlds, and forget the last ones. All randomness must come from `rng`.

        The base class keeps the generators as `self.rngs`, a list of one a world. An attack that keeps more between
        frames overrides this method and calls `super().reset(n_worlds, rng)`.

        Args:
            n_worlds: E.
            rng: a list of one generator a world; the base class and all attacks that ship take a single one, too.
        """
        object.__setattr__(self, "rngs", streams(n_worlds, rng))  # no member of the protocol; frozen dataclasses, too

    @abstractmethod
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
