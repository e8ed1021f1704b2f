"""Numpy's own files, `.npy` and `.npz`, of plain numbers: sizes are checked against the bytes before memory is taken.

Only the header that numpy writes is understood, nothing in it is evaluated; objects, structures and dates are refused.
Source: https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html
"""

from __future__ import annotations

import math
import re
import sys
import zipfile
import zlib
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Literal

import numpy as np

from cp_env.scenes.formats.bounded import check_size, read_bytes

NPZ_BYTES = 64 << 20
"""An archive is at most so long, packed."""

UNPACKED_BYTES = 256 << 20
"""The arrays of an archive hold at most so many bytes together."""

MEMBERS = 1024
"""Arrays of an archive, at most."""

DIRECTORY_BYTES = 1 << 20
"""The directory of an archive is at most so long."""

_MAX_AXIS = 1 << 31

OBJECTS = "|O"
"""The type of an array of pickled objects."""

_END, _LOCATOR = b"PK\x05\x06", b"PK\x06\x07"
_MAGIC = b"\x93NUMPY"
_MAGIC_BYTES = 12  # before the header, at most
_HEADER_BYTES = 4096
_HEADER = re.compile(
    r"\{'descr': '(?P<descr>[<>|]\w{1,12})', 'fortran_order': (?P<fortran>True|False), "
    r"'shape': \((?P<shape>[0-9, ]{0,700})\), \} *\n?"
)
_PLAIN = re.compile(r"[<>|=]?(?:b1|[iu][1248]|f[248]|[US][1-9][0-9]{0,6})")


@dataclass(frozen=True)
class Header:
    """What the beginning of a `.npy` file says."""

    descr: str
    fortran: bool
    shape: tuple[int, ...]
    start: int  # of the numbers; bytes


def plain_dtype(text: str) -> np.dtype:
    """The type of that name.

    Raises:
        ValueError: it is no type of truth values, numbers or texts of fixed length.
    """
    if not _PLAIN.fullmatch(text):
        raise ValueError(f"an array of type {text[:40]!r}; plain numbers, truth values and texts are read")
    return np.dtype(text)


def plain_array(
    data: bytes | memoryview, dtype: np.dtype, shape: tuple[int, ...], *, fortran: bool = False
) -> np.ndarray:
    """The array that lies in `data`, which it must fill; it cannot be written.

    Raises:
        ValueError: sizes that do not fit, too many axes, or a truth value that is neither 0 nor 1.
    """
    if len(shape) > 16 or any(not 0 <= n < _MAX_AXIS for n in shape) or math.prod(shape) * dtype.itemsize != len(data):
        raise ValueError(f"an array of shape {str(shape)[:80]} and type {dtype} that holds {len(data)} bytes")
    if not len(data):
        empty = np.zeros(shape, dtype)
        empty.flags.writeable = False
        return empty
    flat = np.frombuffer(data, dtype)
    if dtype.kind == "b" and flat.size and int(flat.view(np.uint8).max()) > 1:
        raise ValueError("a truth value that is neither 0 nor 1")
    return flat.reshape(shape, order="F" if fortran else "C")


def read_header(data: bytes) -> Header:
    """The header of a `.npy` file.

    Raises:
        ValueError: it is none that numpy writes.
    """
    if data[:6] != _MAGIC or data[6:8] not in (b"\x01\x00", b"\x02\x00", b"\x03\x00"):
        raise ValueError("it does not begin as numpy's files do")
    width = 2 if data[6] == 1 else 4
    size = int.from_bytes(data[8 : 8 + width], "little")
    start = 8 + width + size
    if size > _HEADER_BYTES or start > len(data):
        raise ValueError("its header is cut short, or too long")
    said = _HEADER.fullmatch(data[8 + width : start].decode("utf-8"))
    if said is None:
        raise ValueError("its header is none that numpy writes for plain arrays")
    shape = tuple(int(n) for n in said["shape"].split(",") if n.strip())
    return Header(said["descr"], said["fortran"] == "True", shape, start)


def parse_npy(data: bytes) -> np.ndarray:
    """The array in the bytes of a `.npy` file.

    Raises:
        ValueError: it is none of plain values, or its size is not what its header says.
    """
    header = read_header(data)
    return plain_array(
        memoryview(data)[header.start :], plain_dtype(header.descr), header.shape, fortran=header.fortran
    )


def load_npy(path: Path, limit: int = UNPACKED_BYTES) -> np.ndarray:
    """The array in a `.npy` file; `limit` bounds its bytes.

    Raises:
        OSError: it cannot be read.
        ValueError: it is too long, or as in `parse_npy`.
    """
    return parse_npy(read_bytes(path, limit))


def map_npy(path: Path) -> np.ndarray:
    """The array in a `.npy` file of any size, mapped into memory: what is read of it is what is used.

    Raises:
        OSError: it cannot be read.
        ValueError: it is none of plain values, empty, no regular file, or its size is not what its header says.
    """
    size = check_size(path, sys.maxsize)
    with path.open("rb") as file:
        header = read_header(file.read(_MAGIC_BYTES + _HEADER_BYTES))
    dtype = plain_dtype(header.descr)
    if any(not 0 < n < _MAX_AXIS for n in header.shape) or math.prod(header.shape) * dtype.itemsize != (
        size - header.start
    ):
        raise ValueError(f"an array of shape {str(header.shape)[:80]} and type {dtype} in {size - header.start} bytes")
    order: Literal["F", "C"] = "F" if header.fortran else "C"
    return np.memmap(path, dtype, "r", header.start, header.shape, order)


def load_npz(source: Path | bytes, *, limit: int = NPZ_BYTES, unpacked: int = UNPACKED_BYTES) -> dict[str, np.ndarray]:
    """The arrays of an `.npz` archive by name.

    Args:
        source: the file, or its bytes.
        limit: bytes of the archive.
        unpacked: bytes of all arrays together, as the archive's directory promises them; it is held to that.

    Returns:
        The arrays; they cannot be written.

    Raises:
        OSError: the file cannot be read.
        ValueError: the archive is broken, names an array twice, is packed in another way than numpy does, holds more
            than the bounds, or anything but plain arrays.
    """
    data = read_bytes(source, limit) if isinstance(source, Path) else source
    if len(data) > limit:
        raise ValueError(f"an archive of {len(data)} bytes; at most {limit} are read")
    check_directory(data)
    try:
        with zipfile.ZipFile(BytesIO(data)) as archive:
            members = check_archive(archive, unpacked)
            return {member.filename.removesuffix(".npy"): parse_npy(archive.read(member)) for member in members}
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, OSError) as error:
        raise ValueError(f"it is no archive that can be read: {str(error)[:200]}") from error


def check_directory(tail: bytes, limit: int = DIRECTORY_BYTES) -> None:
    """Hold the directory of a zip archive to a size, before it is read.

    Args:
        tail: the last 64 KiB of the archive, or more.
        limit: bytes.

    Raises:
        ValueError: it is no archive, or its directory is longer.
    """
    end = len(tail) - 22 if tail[-22:-18] == _END and tail[-2:] == b"\0\0" else tail.rfind(_END, -(1 << 16) - 22)
    if end < 0 or end + 22 > len(tail):
        raise ValueError("it is no archive that can be read: its end is missing")
    size = int.from_bytes(tail[end + 12 : end + 16], "little")
    if tail[max(end - 20, 0) : end].startswith(_LOCATOR) and end >= 76:  # of a large archive: it has a second end
        size = int.from_bytes(tail[end - 36 : end - 28], "little")
    if size > limit:
        raise ValueError(f"an archive with a directory of {size} bytes; at most {limit} are read")


def check_archive(archive: zipfile.ZipFile, unpacked: int, members: int = MEMBERS) -> list[zipfile.ZipInfo]:
    """The members of a zip archive.

    Raises:
        ValueError: there are more than `members`, or two of one name; one is neither stored nor deflated, or would
            reach beyond the archive; or the directory promises more than `unpacked` bytes.
    """
    found = archive.infolist()
    if len(found) > members or len({member.filename for member in found}) != len(found):
        raise ValueError(f"an archive of {len(found)} members; at most {members} are read, each of its own name")
    total = sum(member.file_size for member in found)
    if total > unpacked:
        raise ValueError(f"an archive that unpacks to {total} bytes; at most {unpacked} are read")
    for member in found:
        if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) or member.flag_bits & 1:
            raise ValueError(f"{member.filename[:80]!r} is packed or encrypted in a way that is not read")
        if member.header_offset + member.compress_size > archive.start_dir:  # to read it would ask for that much memory
            raise ValueError(f"{member.filename[:80]!r} would take {member.compress_size} bytes of a smaller archive")
    return found
