"""Baselines of every attack: random perturbations, and none."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from torch import Tensor

from agents.attacks.gradient import due, no_perturbation
from agents.attacks.schedule import Schedule, always, make_schedule
from agents.protocol import Streams, streams
from cp_env.perturbation.ball import make_ball
from cp_env.world.situation import Situation


@dataclass
class Noise:
    """Random perturbations: uniform in the L∞ ball; in the L2 ball uniform in direction and length.

    Args:
        schedule: the frames in which it attacks.
    """

    schedule: str | Schedule = always
    _streams: list[np.random.Generator] = field(default_factory=list, init=False, repr=False)

    def __post_init__(self) -> None:
        self._schedule = make_schedule(self.schedule)

    def reset(self, n_worlds: int, rng: Streams) -> None:
        self._streams = streams(n_worlds, rng)

    def act(self, situation: Situation) -> Float[Tensor, "E k C H W"]:
        """See `Attack.act`."""
        delta = no_perturbation(situation)
        ball, (k, c, h, w) = make_ball(situation.norm), delta.shape[1:]
        for e in due(situation, self._schedule).nonzero().flatten().tolist():
            delta[e] = ball.random((k, c, h, w), situation.budget, self._streams[e])
        return delta


class NoPerturbation:
    """Attackers that add no perturbation."""

    def reset(self, n_worlds: int, rng: Streams) -> None:
        del n_worlds, rng

    def act(self, situation: Situation) -> Float[Tensor, "E k C H W"]:
        """See `Attack.act`."""
        return no_perturbation(situation)
