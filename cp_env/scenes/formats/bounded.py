"""Files and JSON of others within stated bounds: what is larger or nested deeper is refused before it is built."""

from __future__ import annotations

import json
import re
import stat
from pathlib import Path
from typing import Any

JSON_BYTES = 16 << 20
"""A JSON text is at most so long."""

JSON_DEPTH = 32
"""Lists and objects of a JSON text are nested at most so deep."""

_TOKENS = re.compile(r'"[^"\\]*(?:\\.[^"\\]*)*"?|[\[{]|[\]}]', re.DOTALL)


def read_bytes(path: Path, limit: int) -> bytes:
    """What a file holds.

    Args:
        path: of a regular file; a pipe or a device is refused.
        limit: bytes that it holds at most.

    Returns:
        Its bytes.

    Raises:
        OSError: it cannot be read.
        ValueError: it is longer, or no regular file.
    """
    size = check_size(path, limit)  # before it is opened: a pipe would wait for its writer
    with path.open("rb") as file:
        return file.read(size)


def check_size(path: Path, limit: int) -> int:
    """The size of a file, in bytes.

    Raises:
        OSError: it cannot be read.
        ValueError: it is longer than `limit`, or no regular file.
    """
    status = path.stat()
    if not stat.S_ISREG(status.st_mode):
        raise ValueError("it is no regular file")
    if status.st_size > limit:
        raise ValueError(f"it holds {status.st_size} bytes; at most {limit} are read")
    return status.st_size


def parse_json(text: str | bytes, *, limit: int = JSON_BYTES, depth: int = JSON_DEPTH) -> Any:
    """What a JSON text says.

    Args:
        text: the text; bytes are UTF-8.
        limit: characters or bytes that it holds at most.
        depth: how deep it may be nested.

    Returns:
        Plain Python values.

    Raises:
        ValueError: it is no JSON, too long, nested too deep, or names a key of an object twice.
    """
    if len(text) > limit:
        raise ValueError(f"a JSON text of {len(text)} characters; at most {limit} are read")
    plain = text.decode("utf-8") if isinstance(text, bytes) else text
    check_depth(plain, depth)
    return json.loads(plain, object_pairs_hook=_distinct)


def check_depth(text: str, depth: int = JSON_DEPTH) -> None:
    """ValueError if brackets outside strings are nested deeper."""
    level = 0
    for token in _TOKENS.finditer(text):
        first = text[token.start()]
        if first != '"':
            level += 1 if first in "[{" else -1
            if level > depth:
                raise ValueError(f"a JSON text that is nested deeper than {depth} levels")


def _distinct(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        names = [key for key, _ in pairs]
        raise ValueError(f"the key {next(key for key in names if names.count(key) > 1)[:80]!r} is named twice")
    return found
