"""Writing files whole or not at all, with a sentence where it cannot be done."""

from __future__ import annotations

import os
import platform
import time
from contextlib import suppress
from pathlib import Path

DRAFT = ".draft"
OLD = 24 * 3600.0
"""Seconds after which the draft of another machine is taken for abandoned."""


class CannotWrite(OSError, ValueError):
    """A file that cannot be written: the disk is full, the folder is read-only, or something stands in its place."""


def write_atomically(path: Path, data: str | bytes) -> None:
    """Write a file under another name, then rename it: a reader sees the old one or the new one, whole.

    Args:
        path: of the file; its folder is made.
        data: what it is to hold.

    Raises:
        CannotWrite: it could not be written; what was there before is as it was.
    """
    draft = path.with_name(f".{path.name[:180]}.{_machine()}.{os.getpid()}{DRAFT}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with draft.open("wb") as file:
            file.write(data.encode() if isinstance(data, str) else data)
            file.flush()
            os.fsync(file.fileno())
        draft.replace(path)
    except OSError as error:
        with suppress(OSError):
            draft.unlink(missing_ok=True)
        raise CannotWrite(
            f"cannot write {path} ({error.strerror or error}): make room, or give another folder; "
            "what is stored stays, and the same command goes on from there"
        ) from error


def check_writable(folder: Path) -> None:
    """CannotWrite unless files can be written into `folder`, which is made."""
    probe = folder / f".probe.{_machine()}.{os.getpid()}{DRAFT}"
    write_atomically(probe, b"\0" * 4096)
    with suppress(OSError):
        probe.unlink()


def remove_drafts(folder: Path) -> list[Path]:
    """Remove the drafts of writers that were killed, in a folder and in those directly in it; returns them.

    A draft is abandoned if the process that wrote it no longer lives, or, where that cannot be asked, after `OLD`.
    """
    removed = []
    for draft in sorted([*folder.glob(f".*{DRAFT}"), *folder.glob(f"*/.*{DRAFT}")]):
        machine, process = draft.name.removesuffix(DRAFT).split(".")[-2:]
        with suppress(OSError):
            here = machine == _machine() and os.name == "posix" and process.isdecimal()
            gone = not _lives(int(process)) if here else time.time() - draft.stat().st_mtime > OLD
            if gone:
                draft.unlink()
                removed.append(draft)
    return removed


def _machine() -> str:
    return "".join(c for c in platform.node() if c.isascii() and (c.isalnum() or c == "-"))[:40] or "here"


def _lives(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True
