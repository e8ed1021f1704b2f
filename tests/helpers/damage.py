"""Small damage to the bytes of a file, as disks, copies and hostile hands do it."""

from __future__ import annotations

import random

DAMAGE = ("cut", "flip", "byte", "insert", "remove", "repeat", "number", "nest", "append")


def damaged(data: bytes, kind: str, rng: random.Random) -> bytes:
    """The bytes with one small damage, mostly near the beginning or the end, where headers and directories are."""
    size = len(data)
    at = min(
        rng.choice([rng.randrange(size), int(size * rng.random() ** 4), size - 1 - int(size * rng.random() ** 4)]),
        size - 1,
    )
    at, length = max(at, 0), rng.choice([1, 2, 4, 8, 30])
    if kind == "cut":
        return data[:at]
    if kind == "flip":
        return data[:at] + bytes([data[at] ^ 1 << rng.randrange(8)]) + data[at + 1 :]
    if kind == "byte":
        return data[:at] + rng.choice([b"\0", b"\xff", b"O", b"[", b"9", b"-"]) + data[at + 1 :]
    if kind == "insert":
        return data[:at] + rng.randbytes(length) + data[at:]
    if kind == "remove":
        return data[:at] + data[at + length :]
    if kind == "repeat":
        return data[:at] + data[at : at + length] * rng.choice([2, 1000]) + data[at + length :]
    if kind == "number":
        return data[:at] + rng.choice([b"\xff", b"\x7f", b"\0"]) * length + data[at + length :]
    if kind == "nest":
        return data[:at] + rng.choice([b"[", b'{"a":', b"(", b"]", b")"]) * 20_000 + data[at:]
    return data + data
