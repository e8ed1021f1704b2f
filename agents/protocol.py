"""The interface of an attack, and the generators that it draws from."""

from __future__ import annotations

import numpy as np

import agents
from cp_env.attack import Attack, Learned, Streams

if "load_policy" not in getattr(agents, "__all__", ()):
    raise ImportError(
        "the package `agents` that Python finds is not cp-env's: PyPI's `agents` and `openai-agents` use that name, "
        "too. Install cp-env in an environment without them"
    )

__all__ = ["Attack", "Learned", "Streams", "streams"]


def streams(n_worlds: int, rng: Streams) -> list[np.random.Generator]:
    """One generator a world, so that a world's noise does not depend on its neighbours."""
    if isinstance(rng, np.random.Generator):
        return rng.spawn(n_worlds)
    if len(rng) != n_worlds:
        raise ValueError(f"one generator a world is needed: {n_worlds} worlds, {len(rng)} generators")
    return list(rng)
