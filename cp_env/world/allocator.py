"""Keep freed memory for the next frame, instead of giving it back to the system and asking for it again."""

from __future__ import annotations

import ctypes
import sys

TRIM_THRESHOLD, MMAP_THRESHOLD = -1, -3
"""Parameters of glibc's `mallopt` (malloc.h)."""

LARGEST = 2**30
"""Bytes up to which a block is taken from the heap, and which may lie free at the heap's end."""


def keep_freed_memory() -> bool:
    """Let glibc keep large blocks that are freed. Where there is no glibc nothing is done.

    A frame's maps take megabytes. By default large blocks go back to the system when they are freed, and the system
    clears each page when it is asked for again: up to a third of a step's time. The programs and workers of this
    project call this first. It holds for the whole process, whose memory then stays as large as it once was: so a
    program of yours decides for itself (docs/speed.md).

    Returns:
        Whether it was done.
    """
    if not sys.platform.startswith("linux"):
        return False
    try:
        mallopt = ctypes.CDLL("libc.so.6").mallopt
    except (OSError, AttributeError):  # another C library
        return False
    return bool(mallopt(MMAP_THRESHOLD, LARGEST)) and bool(mallopt(TRIM_THRESHOLD, LARGEST))
