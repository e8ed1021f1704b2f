"""Files of the scene cache: some packed frames, each with a checksum of its own.

Layout, little-endian: `MAGIC`, number of chunks, for each its length and CRC-32, the CRC-32 of all that, the chunks.
A file is written under a name of its own and renamed when it is whole, so that readers and writers of other processes
meet either nothing or a whole file, and the last of two writers wins.
"""

from __future__ import annotations

import os
import struct
import uuid
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

from cp_env.scenes.errors import BrokenData

MAGIC = b"cp_env\x00\x01"
"""Its last byte is the version of the layout."""

SUFFIX = ".maps"

DRAFT = ".draft-"
"""What the name of an unfinished file begins with."""

LONGEST = 2**27
"""Bytes of a chunk: a file cannot make its reader take more memory."""

COUNT = struct.Struct("<8sI")
ENTRY = struct.Struct("<II")
CHECK = struct.Struct("<I")


def write_block(path: Path, chunks: Sequence[bytes]) -> int:
    """Write the chunks; OSError if that cannot be done. Returns the bytes written."""
    head = COUNT.pack(MAGIC, len(chunks)) + b"".join(ENTRY.pack(len(chunk), zlib.crc32(chunk)) for chunk in chunks)
    content = b"".join([head, CHECK.pack(zlib.crc32(head)), *chunks])
    draft = path.with_name(f"{DRAFT}{uuid.uuid4().hex}")
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        draft.write_bytes(content)
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)
    return len(content)


def read_chunk(path: Path, number: int, n_chunks: int) -> bytes:
    """One of the chunks of a file.

    Args:
        path: the file.
        number: which chunk, from 0.
        n_chunks: how many the file should hold.

    Raises:
        FileNotFoundError: there is no such file.
        BrokenData: it is not as it was written.
    """
    with path.open("rb", buffering=0) as file:
        entries = _entries(path, file, n_chunks)
        ends = [0, *(length for length, _ in entries)]
        start = COUNT.size + ENTRY.size * n_chunks + CHECK.size + sum(ends[: number + 1])
        length, check = entries[number]
        file.seek(start)
        chunk = file.read(length)
    if len(chunk) != length or zlib.crc32(chunk) != check:
        raise BrokenData(path, f"frame {number} of the block is not as it was written")
    return chunk


def _entries(path: Path, file: BinaryIO, n_chunks: int) -> list[tuple[int, int]]:
    """Length and checksum of each chunk."""
    size = COUNT.size + ENTRY.size * n_chunks
    head = file.read(size + CHECK.size)
    if len(head) != size + CHECK.size or zlib.crc32(head[:size]) != CHECK.unpack_from(head, size)[0]:
        raise BrokenData(path, "its head is not as it was written")
    if COUNT.unpack_from(head) != (MAGIC, n_chunks):
        raise BrokenData(path, f"it is no block of {n_chunks} frames of this version")
    entries = [ENTRY.unpack_from(head, COUNT.size + ENTRY.size * i) for i in range(n_chunks)]
    if any(length > LONGEST for length, _ in entries):
        raise BrokenData(path, f"a frame takes more than {LONGEST} bytes")
    whole, held = len(head) + sum(length for length, _ in entries), os.fstat(file.fileno()).st_size
    if held != whole:
        raise BrokenData(path, f"it has {held} bytes, not {whole}")
    return entries
