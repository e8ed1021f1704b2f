"""The checksum of a stored run, and the name that its file must have; and what can be wrong with such a file.

A file is one JSON object. Its first entry is the SHA-256 of the rest, its second the name. That shows accidents and
careless edits. It is no signature: whoever rewrites a file can write a checksum that fits.
"""

from __future__ import annotations

import hashlib
import json
import platform
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from cp_env.scenes.formats.bounded import parse_json

EMPTY = "are empty"
CHANGED = "were cut or changed since they were written, or are of an older version"
FOREIGN = "hold another run than their name says"
UNLIKE = "hold no such episodes as the run has"
UNREADABLE = "cannot be read, or are too large"
COPIES = "hold another run than their name says, or are of an older version"
SHOWN = 5
"""Files that a warning names; the rest is counted."""

_DIGITS = 64
_LEAD = b'{"checksum": "'
_NAME = b'", "name": '


class StoredRunWarning(UserWarning):
    """Stored runs that cannot be used."""


class Broken(ValueError):
    """A file that is not as it was written; the message is one of the kinds above."""


@dataclass(frozen=True)
class Fault:
    """A file of a store that cannot be used."""

    path: Path
    kind: str  # a clause of which such files are the subject


def versions() -> dict[str, str]:
    """What a run was made with: it is told, but does not make another run of it."""
    return {"python": platform.python_version(), "numpy": np.__version__, "torch": str(torch.__version__)}


def stamp(name: str, content: dict[str, Any]) -> str:
    """The text of the file of that name (without suffix) that holds `content`."""
    body = json.dumps({"name": name, **content}) + "\n"
    digest = hashlib.sha256(body.encode()).hexdigest()
    return f'{{"checksum": "{digest}", {body[1:]}'


def verify(text: bytes, name: str) -> dict[str, Any]:
    """What `stamp` was given.

    Args:
        text: the bytes of the file.
        name: of the file, without suffix.

    Returns:
        The content, the name included.

    Raises:
        Broken: the file is empty, was changed, or holds another run than its name says.
    """
    if not text.strip():
        raise Broken(EMPTY)
    digest, body = text[len(_LEAD) : len(_LEAD) + _DIGITS], b"{" + text[len(_LEAD) + _DIGITS + 3 :]
    if not _stamped(text) or hashlib.sha256(body).hexdigest().encode() != digest:
        raise Broken(CHANGED)
    try:
        content = parse_json(body)
    except ValueError as error:
        raise Broken(UNLIKE) from error
    if not isinstance(content, dict) or content.pop("name", None) != name:
        raise Broken(FOREIGN)
    return content


def copies(folder: Path, planned: Iterable[Path]) -> list[Fault]:
    """The files of a folder, beside those planned, that are not what their names say; only their beginnings are read.

    Files of other plans, whose names fit, are none. Nothing here is counted in any case: a plan reads its own files.
    """
    known, faults = set(planned), []
    for path in sorted(folder.glob("*.json")):
        if path not in known and not path.name.startswith("."):
            lead = _LEAD + b"0" * _DIGITS + _NAME + json.dumps(path.stem).encode()
            try:
                with path.open("rb") as file:
                    start = file.read(len(lead) + 1)
            except OSError:
                continue
            if not _stamped(start) or start[len(_LEAD) + _DIGITS : -1] != lead[len(_LEAD) + _DIGITS :]:
                faults.append(Fault(path, COPIES))
    return faults


def warn_of(faults: Sequence[Fault], consequence: str = "they are not counted, and are played anew") -> None:
    """One warning for each kind of fault, which names its files."""
    for kind in dict.fromkeys(fault.kind for fault in faults):
        names = [fault.path.name for fault in faults if fault.kind == kind]
        more = f", and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
        folder = next(fault.path.parent for fault in faults if fault.kind == kind)
        warnings.warn(
            f"{len(names)} stored runs in {folder} {kind}; {consequence}: {', '.join(names[:SHOWN])}{more}",
            StoredRunWarning,
            stacklevel=3,
        )


def _stamped(start: bytes) -> bool:
    """Whether a file begins as `stamp` writes them."""
    end = len(_LEAD) + _DIGITS
    return start.startswith(_LEAD) and start[end : end + len(_NAME)] == _NAME
