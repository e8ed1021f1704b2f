"""An attack on a timetable, from a string: `pgd:every=3`, `in_loop:start=20`, `ramp:duty=0.5`."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from agents.attacks.schedule import every
from agents.protocol import Attack, Streams, streams
from cp_env.world.situation import Situation


@dataclass
class Timed:
    """`attack` in the frames `start`, `start + every`, …, and of those in a share `duty`, drawn anew in each.

    Threat model: the attack's own, by attackers that know that the defence has a memory: that it forgives, settles its
    verdict, or lets counts decay. Sources: the intermittent attacks of PRBI's Table 6; the on-off attack on trust
    systems (Sun, Han, Liu, "Defense of Trust Management Vulnerabilities in Distributed Networks", 2008). In the other
    frames the attack is shown a situation in which nothing it sends has an effect, as in a frame of grace.

    Args:
        attack: the attack.
        every: period, in frames.
        start: the first frame.
        duty: share of those frames in which it attacks.
    """

    attack: Attack
    every: int = 1
    start: int = 0
    duty: float = 1.0
    _streams: list[np.random.Generator] = field(default_factory=list, init=False, repr=False)

    def __post_init__(self) -> None:
        self._schedule = every(self.every, self.start)
        if not 0 < self.duty <= 1:
            raise ValueError(f"duty is a share of the frames, above 0 and at most 1; got {self.duty}")

    def reset(self, n_worlds: int, rng: Streams) -> None:
        own = streams(n_worlds, rng)
        self._streams = [stream.spawn(1)[0] for stream in own]
        self.attack.reset(n_worlds, own)

    def act(self, situation: Situation) -> Float[Tensor, "E k C H W"]:
        """See `Attack.act`."""
        drawn = np.array([stream.random() < self.duty for stream in self._streams])
        due = torch.from_numpy(drawn & self._schedule(situation.frame)).to(situation.active.device)
        delta = self.attack.act(replace(situation, active=situation.active & due))
        return delta * due[:, None, None, None, None]
