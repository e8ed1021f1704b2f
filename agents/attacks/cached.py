"""A cache for attacks that know of no defence: computed once for all the defenders they meet.

Gradient ascent takes most of the time of an episode. An attack that knows nothing of the defence does the same against
every defender: in a comparison of defenders only the first has to wait for it.
"""

from __future__ import annotations

import copy
import hashlib
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import NoReturn

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from agents.protocol import Attack, Streams, streams
from cp_env.world.situation import Situation

WITHHELD = ("fused", "output", "verdict", "simulate", "features", "receive", "perceive_clean", "detector")
"""Fields of a situation that reveal the defence, and those that follow from the maps and the detector's digest."""


@dataclass
class CachedAttack:
    """`attack` with a cache: in a situation with the same history since the episode's first frame, it answers at once.

    It is shown nothing of the defence: all present seem to be fused, no frame seems to have been judged, and `simulate`
    raises a ValueError.

    Args:
        attack: the attack whose answers are cached.
        frames: number of answers kept, one for all worlds of a frame; the oldest are dropped first.
    """

    attack: Attack
    frames: int = 128
    computed: int = field(default=0, init=False)  # answers that were not in the cache
    _cache: OrderedDict[bytes, tuple[Tensor, Attack]] = field(default_factory=OrderedDict, init=False, repr=False)
    _history: bytes = field(default=b"", init=False, repr=False)  # of the episode so far: what an answer depends on

    def reset(self, n_worlds: int, rng: Streams) -> None:
        generators = streams(n_worlds, rng)
        self.attack = copy.deepcopy(self.attack)  # the cache keeps the last one as it is
        self.attack.reset(n_worlds, generators)
        self._history = _digest(repr([one.bit_generator.state for one in generators]).encode())

    def act(self, situation: Situation) -> Float[Tensor, "E k C H W"]:
        """See `Attack.act`."""
        self._history = _digest(self._history, *_facts(situation))
        if self._history not in self._cache:
            acting = copy.deepcopy(self.attack)
            self._cache[self._history] = acting.act(_undefended(situation)), acting
            self.computed += 1
        self._cache.move_to_end(self._history)
        while len(self._cache) > self.frames:
            self._cache.popitem(last=False)
        delta, self.attack = self._cache[self._history]
        return delta.clone()


def _undefended(situation: Situation) -> Situation:
    """The same situation without what it shows of the defence."""
    nothing = (None,) * len(situation.fused)
    return replace(situation, fused=situation.present, output=nothing, verdict=nothing, simulate=_refuse)


def _refuse(delta: Float[Tensor, "E k C H W"], rng: Sequence[np.random.Generator]) -> NoReturn:
    raise ValueError("a cached attack knows of no defence and cannot simulate it: play it without the cache")


def _facts(situation: Situation) -> list[bytes | memoryview]:
    """Everything else in a situation that an answer may depend on."""
    shown = {part.name: getattr(situation, part.name) for part in fields(situation) if part.name not in WITHHELD}
    bits = {name: _bits(value) for name, value in (shown | {"received": situation.received}).items()}
    return [
        situation.detector.digest.encode(),
        *(part for item in bits.items() for part in (item[0].encode(), item[1])),
    ]


def _bits(value: Tensor | np.ndarray | float | str | None) -> bytes | memoryview:
    if isinstance(value, Tensor):
        return memoryview(value.detach().cpu().flatten().view(torch.uint8).numpy())  # any precision, not copied
    return value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode()


def _digest(*parts: bytes | memoryview) -> bytes:
    digest = hashlib.sha256()  # processors have instructions for it: a frame's maps take megabytes
    for part in parts:
        digest.update(len(part).to_bytes(8, "little"))
        digest.update(part)
    return digest.digest()
