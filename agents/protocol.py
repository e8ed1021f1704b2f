"""What an attacker is: it is shown the situation of all worlds and returns what the liars add to their maps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float
from torch import Tensor

from cp_env.world.situation import Situation

Streams = np.random.Generator | Sequence[np.random.Generator]


@runtime_checkable
class Attacker(Protocol):
    """Drives the liars of E worlds at once. The victim is frozen: an attacker never changes its detector."""

    def reset(self, n_worlds: int, rng: Streams) -> None:
        """New episodes begin in all worlds; all randomness must come from `rng`: one stream, or one for each world."""
        ...

    def act(self, situation: Situation) -> Float[Tensor, "E k C H W"]:
        """δ of every liar, in its sender's frame, inside the budget."""
        ...


def streams(n_worlds: int, rng: Streams) -> list[np.random.Generator]:
    """One generator a world, so that a world's noise does not depend on its neighbours."""
    if isinstance(rng, np.random.Generator):
        return rng.spawn(n_worlds)
    if len(rng) != n_worlds:
        raise ValueError(f"one generator a world is needed: {n_worlds} worlds, {len(rng)} generators")
    return list(rng)
