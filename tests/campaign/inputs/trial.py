"""A family of inputs: how one input is made from a seeded generator and tried."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from random import Random

Try = Callable[[Random], bool]
"""Makes one input and hands it in; whether it was taken. A documented refusal raises one of the family's errors."""


@dataclass(frozen=True)
class Family:
    """One kind of inputs.

    Attributes:
        prepare: makes what tries inputs, in an empty folder.
        refusals: the documented errors.
        share: of all inputs.
        chunk: inputs of one case.
    """

    prepare: Callable[[Path], Try]
    refusals: tuple[type[Exception], ...]
    share: float
    chunk: int
