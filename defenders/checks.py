"""Checks of options that several defenders share."""

from __future__ import annotations


def check_choice(name: str, value: object, known: tuple[str, ...]) -> None:
    """ValueError listing the known values unless `value` is one of them."""
    if value not in known:
        raise ValueError(f"{name} must be one of {', '.join(known)}; got {value!r}")
