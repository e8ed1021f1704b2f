"""The interface of an attack, and the generators that it draws from."""

from __future__ import annotations

import agents
from cp_env.attack import Attack, Learned, Streams, streams

if "load_policy" not in getattr(agents, "__all__", ()):
    raise ImportError(
        "the package `agents` that Python finds is not cp-env's: PyPI's `agents` and `openai-agents` use that name, "
        "too. Install cp-env in an environment without them"
    )

__all__ = ["Attack", "Learned", "Streams", "streams"]
