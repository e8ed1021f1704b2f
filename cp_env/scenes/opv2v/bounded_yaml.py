"""YAML as plain data within stated bounds: what is larger, deeper or more often repeated is refused before it is built.

Read are maps, lists, words, numbers, aliases, merge keys, binary data, and numpy's arrays and numbers as PyYAML writes
them (V2V4Real's poses); any other tag is refused, so that nothing of a file is executed. The text is taken apart into
events, one by one, and built without recursion: depth costs nothing until it is refused. `1e-07` is a number, which
YAML 1.1 takes for a word.
"""

from __future__ import annotations

import binascii
from dataclasses import dataclass, field
from math import prod
from typing import Any

import numpy as np

MAX_BYTES = 4 << 20
"""A text is at most so long; a frame of OPV2V takes some tens of kilobytes."""

MAX_DEPTH = 32
"""Lists and maps are nested at most so deep."""

MAX_NODES = 200_000
"""Lists, maps and scalars of a text, an alias counted as all that it repeats."""

NEEDS_YAML = "reading OPV2V needs PyYAML; install this package with its extra: pip install '.[opv2v]'"
_TAG = "tag:yaml.org,2002:"
_PLAIN = {None, "!", *(_TAG + name for name in ("seq", "map", "str", "int", "float", "bool", "null"))}
_NUMBERS = {_TAG + name for name in ("int", "float", "bool", "null")}
_ARRAY = tuple(f"{_TAG}python/object/apply:numpy.{core}.multiarray._reconstruct" for core in ("core", "_core"))
_NUMBER = tuple(f"{_TAG}python/object/apply:numpy.{core}.multiarray.scalar" for core in ("core", "_core"))
_DTYPE = f"{_TAG}python/object/apply:numpy.dtype"
_NAMES = (f"{_TAG}python/name:numpy.ndarray",)
_WORDS: dict[str, Any] = {"": None, "~": None, "null": None, "Null": None, "NULL": None}
_WORDS |= {word: word.lower() == "true" for word in ("true", "True", "TRUE", "false", "False", "FALSE")}
_WORDS |= {sign + "." + word: float(sign + word) for sign in ("", "+", "-") for word in ("inf", "Inf", "INF")}
_WORDS |= {word: float("nan") for word in (".nan", ".NaN", ".NAN")}


class RefusedYaml(ValueError):
    """A text that is no YAML, or none that is read here."""


@dataclass
class _Open:
    """A list or map whose end is not reached."""

    tag: str | None
    anchor: str | None
    is_map: bool
    begin: int  # nodes before it
    items: list[Any] = field(default_factory=list)  # of a map: key, value, key, value …

    def close(self) -> Any:
        if self.tag in _ARRAY or self.tag in _NUMBER or self.tag == _DTYPE:
            return _of_numpy(self.tag, _mapped(self.items) if self.is_map else self.items)
        return _mapped(self.items) if self.is_map else self.items


def load(text: str | bytes) -> Any:
    """What a text says; None if it says nothing.

    Args:
        text: one document.

    Returns:
        Plain Python values, and numpy arrays where the text holds them. What is repeated by an alias is one object.

    Raises:
        RefusedYaml: it is no YAML, beyond a bound, or holds what is no plain data.
        ImportError: PyYAML is not installed.
    """
    try:
        import yaml
    except ImportError as error:
        raise ImportError(NEEDS_YAML) from error
    if len(text) > MAX_BYTES:
        raise RefusedYaml(f"is YAML of {len(text)} bytes; at most {MAX_BYTES} are read")
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    try:
        parser = loader(text)
        try:
            return _build(yaml, parser)
        finally:
            parser.dispose()
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise RefusedYaml(f"is no YAML: {' '.join(str(error).split())[:200]}") from error


class _Builder:
    """Values out of events, one after the other; what is open waits on a list, not on the interpreter's stack."""

    def __init__(self) -> None:
        self._stack = [_Open(None, None, False, 0)]
        self._anchors: dict[str, tuple[Any, int]] = {}  # what it names, and of how many nodes that is
        self._nodes = 0

    @property
    def value(self) -> Any:
        said = self._stack[0].items
        return said[0] if said else None

    def begin(self, event: Any, *, is_map: bool) -> None:
        if len(self._stack) > MAX_DEPTH:
            raise RefusedYaml(f"is YAML nested deeper than {MAX_DEPTH} levels")
        _check_tag(event.tag)
        self._stack.append(_Open(event.tag, event.anchor, is_map, self._nodes))
        self._count(1)

    def end(self) -> None:
        done = self._stack.pop()
        self._put(done.close(), done.anchor, self._nodes - done.begin)

    def scalar(self, event: Any) -> None:
        self._count(1)
        self._put(_scalar(event), event.anchor, 1)

    def alias(self, event: Any) -> None:
        if event.anchor not in self._anchors:
            raise RefusedYaml(f"is no YAML: the alias *{event.anchor:.80} names nothing that is complete before it")
        value, size = self._anchors[event.anchor]
        self._count(size)
        self._put(value, None, size)

    def _put(self, value: Any, anchor: str | None, size: int) -> None:
        if anchor is not None:
            self._anchors[anchor] = value, size
        self._stack[-1].items.append(value)

    def _count(self, size: int) -> None:
        self._nodes += size
        if self._nodes > MAX_NODES:
            raise RefusedYaml(f"is YAML of more than {MAX_NODES} values, aliases counted as what they repeat")


def _build(yaml: Any, parser: Any) -> Any:
    builder = _Builder()
    documents = 0
    while parser.check_event():
        event = parser.get_event()
        kind = type(event)
        if kind is yaml.ScalarEvent:
            builder.scalar(event)
        elif kind is yaml.AliasEvent:
            builder.alias(event)
        elif kind is yaml.SequenceStartEvent or kind is yaml.MappingStartEvent:
            builder.begin(event, is_map=kind is yaml.MappingStartEvent)
        elif kind is yaml.SequenceEndEvent or kind is yaml.MappingEndEvent:
            builder.end()
        elif kind is yaml.DocumentStartEvent:
            documents += 1
            if documents > 1:
                raise RefusedYaml("is YAML of several documents; one is read")
    return builder.value


def _check_tag(tag: str | None) -> None:
    known = tag in _PLAIN or tag == f"{_TAG}python/tuple" or tag == _DTYPE or tag in _ARRAY or tag in _NUMBER
    if not known:
        raise RefusedYaml(f"is no YAML of plain data: it holds the tag {tag:.120}, and nothing of it is executed")


def _scalar(event: Any) -> Any:
    text: str = event.value
    if event.tag is not None and event.tag not in _PLAIN:
        if event.tag == f"{_TAG}binary":
            try:
                return binascii.a2b_base64(text.encode("ascii", errors="replace"))
            except binascii.Error as error:
                raise RefusedYaml(f"is no YAML: {error} in its binary data") from error
        if event.tag not in _NAMES:
            _check_tag(event.tag)
        return text
    if not event.implicit[0] and event.tag not in _NUMBERS:  # quoted, or said to be a word
        return text
    if text in _WORDS:
        return _WORDS[text]
    if text[0] in "+-.0123456789":
        for number in (int, float):
            try:
                return number(text)
            except ValueError:
                pass
    return text


def _mapped(items: list[Any]) -> dict[Any, Any]:
    """Keys and values in turn; `<<` merges, and a key that is named twice keeps its last value."""
    found: dict[Any, Any] = {}
    merged: list[dict[Any, Any]] = []
    for key, value in zip(items[::2], items[1::2], strict=True):
        if isinstance(key, list | dict | np.ndarray):
            raise RefusedYaml("is no YAML of plain data: a list or a map is a key")
        if key == "<<":
            merged += [part for part in (value if isinstance(value, list) else [value]) if isinstance(part, dict)]
        else:
            found[key] = value
    return {key: value for part in [*merged[::-1], found] for key, value in part.items()} if merged else found


def _of_numpy(tag: str | None, said: Any) -> Any:
    """A dtype (its name), an array or a number as PyYAML writes numpy's: bytes of plain numbers and their shape."""
    try:
        if tag == _DTYPE:
            order = said["state"][1] if said["state"][1] in "<>" else ""
            return order + {"f8": "f8", "f4": "f4", "i8": "i8", "i4": "i4"}[said["args"][0]]
        if tag in _NUMBER:
            return np.frombuffer(said[1], np.dtype(said[0]), 1)[0].item()
        _, shape, dtype, by_columns, data = said["state"]
        if len(shape) > 2 or prod(shape) * np.dtype(dtype).itemsize != len(data):
            raise ValueError(f"its shape is {shape}")
        return np.frombuffer(data, np.dtype(dtype)).reshape(shape, order="F" if by_columns else "C")
    except (KeyError, IndexError, TypeError, ValueError, OverflowError) as error:
        raise RefusedYaml(f"is no YAML of plain data: an array of numpy cannot be read ({str(error)[:80]})") from error
