"""Things that fit in a spec string: a name, and numbers behind it if it needs any: `every@3`, `remove@12.5:-3`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TypeVar

T = TypeVar("T")


def named(what: str, text: str, known: Mapping[str, Callable[..., T]]) -> T:
    """`known[name](*numbers)` for the text `name` or `name@number:number`.

    Args:
        what: the kind of thing, for messages.
        text: the spec.
        known: constructors by name.

    Returns:
        What the constructor makes.

    Raises:
        ValueError: an unknown name, text where a number is expected, or numbers that the constructor does not take.
    """
    name, _, rest = text.partition("@")
    if name not in known:
        raise ValueError(f"unknown {what} {text!r}; known: {', '.join(known)}; numbers go behind an @: name@1:2.5")
    try:
        return known[name](*(_number(part) for part in filter(None, rest.split(":"))))
    except TypeError as error:
        raise ValueError(f"{what} {text!r}: {name} does not take these numbers ({error})") from error


def _number(text: str) -> int | float:
    try:
        return int(text)
    except ValueError:
        pass
    try:
        return float(text)
    except ValueError as error:
        raise ValueError(f"behind an @ stand numbers, as in name@1:2.5; got {text!r}") from error
