"""An attack that knows of no defence, computed once for all the defences it meets.

Gradient ascent takes most of the time of an episode, and one whose liars know nothing of the defence does the same
against every defender: in a comparison of defenders only the first has to wait for it.
"""

from __future__ import annotations

import copy
import hashlib
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import NoReturn

import numpy as np
from jaxtyping import Float
from torch import Tensor

from agents.protocol import Attacker, Streams, streams
from cp_env.world.situation import Situation

UNTOLD = ("fused", "output", "verdict", "rehearse", "features", "clean", "detector")
"""Fields of a situation that tell of the defence, and those that follow from the rest and the detector's digest."""


@dataclass
class Remembered:
    """`attacker`, whose answers are kept: asked the same again, from the episode's first frame on, it answers at once.

    It is shown nothing of the defence: all present seem to be fused, no frame seems to have been judged, and `rehearse`
    raises a ValueError. The last `frames` answers are kept, one for all worlds of a frame.
    """

    attacker: Attacker
    frames: int = 128
    computed: int = field(default=0, init=False)  # answers that could not be remembered
    _known: OrderedDict[bytes, tuple[Tensor, Attacker]] = field(default_factory=OrderedDict, init=False, repr=False)
    _story: bytes = field(default=b"", init=False, repr=False)  # of the episode so far: what an answer depends on

    def reset(self, n_worlds: int, rng: Streams) -> None:
        generators = streams(n_worlds, rng)
        self.attacker = copy.deepcopy(self.attacker)  # the last one is remembered as it is
        self.attacker.reset(n_worlds, generators)
        self._story = _digest(repr([one.bit_generator.state for one in generators]).encode())

    def act(self, situation: Situation) -> Float[Tensor, "E k C H W"]:
        """See `Attacker.act`."""
        self._story = _digest(self._story, *_facts(situation))
        if self._story not in self._known:
            acting = copy.deepcopy(self.attacker)
            self._known[self._story] = acting.act(_undefended(situation)), acting
            self.computed += 1
        self._known.move_to_end(self._story)
        while len(self._known) > self.frames:
            self._known.popitem(last=False)
        delta, self.attacker = self._known[self._story]
        return delta.clone()


def _undefended(situation: Situation) -> Situation:
    """The same where nobody defends, as far as one can see."""
    nothing = (None,) * len(situation.fused)
    return replace(situation, fused=situation.present, output=nothing, verdict=nothing, rehearse=_refuse)


def _refuse(delta: Float[Tensor, "E k C H W"], rng: Sequence[np.random.Generator]) -> NoReturn:
    raise ValueError("a remembered attacker knows of no defence and cannot rehearse it: play it as it is")


def _facts(situation: Situation) -> list[bytes]:
    """Everything else of a situation that an answer may depend on."""
    told = {part.name: getattr(situation, part.name) for part in fields(situation) if part.name not in UNTOLD}
    bits = {name: _bits(value) for name, value in told.items()}
    return [
        situation.detector.digest.encode(),
        *(part for item in bits.items() for part in (item[0].encode(), item[1])),
    ]


def _bits(value: Tensor | np.ndarray | float | str | None) -> bytes:
    if isinstance(value, Tensor):
        return value.detach().cpu().contiguous().numpy().tobytes()
    return value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode()


def _digest(*parts: bytes) -> bytes:
    digest = hashlib.blake2b(digest_size=16)
    for part in parts:
        digest.update(len(part).to_bytes(8, "little") + part)
    return digest.digest()
