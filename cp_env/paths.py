"""Where the library keeps files of its own, and how much of them."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

UNITS = {"": 1, "B": 1, "KB": 10**3, "MB": 10**6, "GB": 10**9, "TB": 10**12}


def cache_directory() -> Path:
    """The folder of encoded scenes and indices; the environment variable `CP_ENV_CACHE` moves it."""
    override = os.environ.get("CP_ENV_CACHE")
    if override:
        return Path(override)
    import platformdirs

    return Path(platformdirs.user_cache_dir("cp_env"))


def cache_limit() -> int | None:
    """Bytes that encoded scenes may take, from the environment variable `CP_ENV_CACHE_SIZE`; None if it is not set.

    Raises:
        ValueError: it is no size.
    """
    text = os.environ.get("CP_ENV_CACHE_SIZE")
    try:
        return size_of(text) if text else None
    except ValueError as error:
        raise ValueError(f"the environment variable CP_ENV_CACHE_SIZE: {error}") from error


def room_in_memory() -> int:
    """Bytes that a process may keep of what it can read again: a 16th of the machine's memory, 128 MB to 2 GB."""
    try:
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):  # not on every system
        memory = 0
    return min(max(memory // 16, 2**27), 2**31)


def size_of(text: str) -> int:
    """Bytes from a text such as "500 MB" or "20GB"; a bare number is bytes.

    Raises:
        ValueError: it is no size.
    """
    found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([KMGT]?B?)\s*", text, re.IGNORECASE)
    unit = None if found is None else found[2].upper()
    if found is None or unit not in UNITS:
        raise ValueError(f'a size is a number with B, KB, MB, GB or TB, as in "20 GB", not {text!r:.40}')
    return int(float(found[1]) * UNITS[unit])


def use_current_folder() -> None:
    """Let Python import from the current folder, where classes of yours are, as `python` itself does."""
    here = str(Path.cwd())
    if here not in sys.path and "" not in sys.path:
        sys.path.insert(0, here)
