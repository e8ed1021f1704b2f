"""What an attack is: it is shown the situation of all worlds and returns what the attackers add to their maps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, runtime_checkable
from typing import Protocol as Interface

import numpy as np
from jaxtyping import Float
from torch import Tensor

from cp_env.world.situation import Situation


@runtime_checkable
class Attacker(Interface):
    """A scripted attacker: it drives the liars of all worlds (see `agents.protocol`)."""

    def reset(self, n_worlds: int, rng: Sequence[np.random.Generator]) -> None: ...

    def act(self, situation: Situation) -> Float[Tensor, "E k C H W"]: ...


@runtime_checkable
class Learned(Interface):
    """A learned attacker: from the observations of an environment made with `knobs` to its actions."""

    @property
    def knobs(self) -> Mapping[str, Any]: ...

    def __call__(self, observations: Any) -> Float[np.ndarray, "E k a"]: ...
