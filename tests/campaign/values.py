"""Values that nobody should give, seeded, for the inputs of the campaign."""

from __future__ import annotations

import datetime
import decimal
import fractions
from collections.abc import Callable, Sequence
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import torch


class Raising:
    """An object whose conversions fail, as those of a closed file or of a lazy array do."""

    def __float__(self) -> float:
        raise RuntimeError("it has no number")

    def __len__(self) -> int:
        raise RuntimeError("it has no length")

    def __iter__(self) -> Any:
        raise RuntimeError("it has no items")

    def __array__(self, dtype: Any = None, copy: Any = None) -> Any:
        raise RuntimeError("it has no array")


def _recursive() -> list[Any]:
    items: list[Any] = [1]
    items.append(items)
    return items


def _nested(depth: int) -> list[Any]:
    items: list[Any] = []
    for _ in range(depth):
        items = [items]
    return items


STRANGE: tuple[Callable[[], Any], ...] = (
    lambda: None,
    lambda: True,
    lambda: 10**400,
    lambda: -(2**63),
    lambda: 2**64,
    lambda: float("nan"),
    lambda: float("-inf"),
    lambda: 1e308,
    lambda: -0.0,
    lambda: 1 + 2j,
    lambda: "",
    lambda: "\0",
    lambda: "\ud800",
    lambda: "‮١٢٣",
    lambda: "9" * 5000,
    lambda: "x" * 100_000,
    lambda: b"bytes",
    lambda: bytearray(3),
    lambda: memoryview(b"12"),
    list,
    lambda: (),
    dict,
    lambda: {1: 2},
    lambda: {"a": {"b": None}},
    lambda: {1, 2},
    lambda: _recursive(),
    lambda: _nested(5000),
    lambda: [[1], [1, 2]],
    lambda: range(10**9),
    lambda: iter([1, 2]),
    lambda: (i for i in range(3)),
    lambda: object(),
    lambda: Raising(),
    lambda: Raising,
    lambda: int,
    lambda: print,
    lambda: ...,
    lambda: NotImplemented,
    lambda: decimal.Decimal("NaN"),
    lambda: fractions.Fraction(1, 3),
    lambda: datetime.date(2000, 1, 1),
    lambda: Path("nowhere"),
    lambda: slice(3),
    lambda: np.float32("nan"),
    lambda: np.int64(-3),
    lambda: np.bool_(True),
    lambda: np.str_("text"),
    lambda: np.datetime64("NaT"),
    lambda: np.zeros(0),
    lambda: np.zeros((2, 0, 3)),
    lambda: np.array([None, 1], dtype=object),
    lambda: np.ma.masked_array([1.0, 2.0], mask=[True, False]),
    lambda: np.array(["a", "b"]),
    lambda: np.zeros(3, dtype="V8"),
    lambda: np.zeros(2, dtype=[("a", "f4"), ("b", "i8")]),
    lambda: np.broadcast_to(np.float32(0), (10**6, 10**6)),
    lambda: np.array(3.5),
    lambda: torch.zeros(3, requires_grad=True),
    lambda: torch.zeros(3, device="meta"),
    lambda: torch.zeros(3, dtype=torch.complex64),
    lambda: torch.zeros(2, 2).to_sparse(),
    lambda: torch.tensor(float("nan")),
    lambda: torch.zeros(3, dtype=torch.bfloat16),
)
"""Makers of strange values, each of which makes a new one."""


def strange(rng: Random) -> Any:
    """One of `STRANGE`, or a small collection of such."""
    made = rng.choice(STRANGE)()
    kind = rng.random()
    if kind < 0.08:
        return [made, rng.choice(STRANGE)()]
    if kind < 0.12:
        return (rng.randint(-2, 9), made)
    if kind < 0.16:
        return {rng.choice(["scene", "start", "absent", "x", "adversary_0"]): made}
    return made


def number(rng: Random) -> Any:
    """A number, mostly near an edge."""
    return rng.choice(
        [
            rng.randint(-3, 12),
            rng.randint(-(2**70), 2**70),
            rng.uniform(-1, 2),
            rng.gauss(0, 1) * 10.0 ** rng.randint(-320, 308),
            np.float32(rng.uniform(-1, 1)),
            np.int8(rng.randint(-128, 127)),
            float(rng.randint(-3, 9)),
        ]
    )


ALPHABET = "abeinoprst_=:,.-+*/\\[](){}0123456789 \t\n\0\"'%<>&|;!?#@~^$äß∆‮\u200b\ud800😀"


def text(rng: Random, words: Sequence[str]) -> str:
    """Words, signs between them, and now and then something cut, doubled, or made long."""
    parts = []
    for _ in range(rng.randint(1, 7)):
        kind = rng.random()
        if kind < 0.6:
            parts.append(rng.choice(words))
        elif kind < 0.9:
            parts.append(rng.choice([":", ":", "=", "=", ",", ",", " ", "", "[", "]", "(", ")"]))
        else:
            parts.append("".join(rng.choice(ALPHABET) for _ in range(rng.randint(1, 12))))
    made = "".join(parts)
    kind = rng.random()
    if kind < 0.05:
        return made * rng.choice([2, 50, 3000])
    if kind < 0.15 and made:
        at = rng.randrange(len(made))
        return made[:at] + rng.choice(ALPHABET) + made[at + rng.randint(0, 2) :]
    return made
