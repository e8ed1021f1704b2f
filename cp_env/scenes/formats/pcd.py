"""Point clouds in the PCD format, version 0.7, of the Point Cloud Library: text, binary and compressed binary.

Only `x y z` are read, whatever other fields there are; points that are not finite mean "no return" and are dropped; the
header's VIEWPOINT is ignored, as Open3D does. Source: https://pointclouds.org/documentation/tutorials/pcd_file_format.html
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32

from cp_env.scenes.errors import BrokenData
from cp_env.scenes.formats import decimals
from cp_env.scenes.formats.bounded import read_bytes

VERSIONS = ("0.7", ".7")
ENCODINGS = ("ascii", "binary")
"""What `write` writes; `read` also reads "binary_compressed"."""

FILE_BYTES = 256 << 20
"""A file is at most so long, and so are the points that it packs."""

TEXT_BYTES = 32 << 20
"""The points of a text are at most so long: reading them takes up to fifteen times that."""

HEADER_BYTES = 1 << 16
MAX_FIELDS = 64


@dataclass(frozen=True)
class Header:
    """What the header of a file says."""

    row: np.dtype  # one point: field names and types, in the order of the file
    points: int
    data: str  # "ascii" | "binary" | "binary_compressed"


def read(path: Path) -> Float32[np.ndarray, "P 3"]:
    """The points of a file, in the frame it was written in; m.

    Raises:
        BrokenData: the file is missing, of another version, cut short, larger than the bounds above, or holds no x, y,
            z.
    """
    try:
        content = read_bytes(path, FILE_BYTES)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise BrokenData(path, f"cannot be read: {reason}") from error
    try:
        header, body = _header(content)
        rows = {"ascii": _text, "binary": _binary, "binary_compressed": _compressed}[header.data](header, body)
    except (ValueError, KeyError, IndexError, TypeError, OverflowError, struct.error) as error:
        raise BrokenData(path, f"is no point cloud that can be read: {str(error)[:300]}") from error
    finite = np.isfinite(rows)
    return rows if finite.all() else rows[finite.all(axis=1)]


def write(path: Path, points: Float[np.ndarray, "P 3"], *, data: str = "binary") -> None:
    """Store `points`, m, with a colour of 0 for each: readers that take intensity from the colour find it.

    Raises:
        ValueError: unknown encoding.
    """
    if data not in ENCODINGS:
        raise ValueError(f"data must be one of {', '.join(ENCODINGS)}; got {data!r}")
    rows = np.zeros((len(points), 4), dtype="<f4")
    rows[:, :3] = points
    header = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F F\n"
        f"COUNT 1 1 1 1\nWIDTH {len(rows)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(rows)}\nDATA {data}\n"
    )
    if data == "binary":
        body = rows.tobytes()
    else:
        body = "".join(f"{x:.5f} {y:.5f} {z:.5f} 0\n" for x, y, z, _ in rows.tolist()).encode()
    path.write_bytes(header.encode() + body)


def _header(content: bytes) -> tuple[Header, memoryview]:
    said: dict[str, list[str]] = {}
    start = 0
    while "DATA" not in said:
        end = content.find(b"\n", start, HEADER_BYTES)
        if end < 0:
            raise ValueError("its header ends before the line DATA")
        words = content[start:end].decode("ascii", errors="replace").split()
        if words and not words[0].startswith("#"):
            said[words[0].upper()] = words[1:]
        start = end + 1
    if "".join(said.get("VERSION", ["none"])) not in VERSIONS:
        raise ValueError(f"its version is {' '.join(said.get('VERSION', ['not given']))}, this program reads 0.7")
    fields = said["FIELDS"]
    if not {"x", "y", "z"} <= set(fields):
        raise ValueError(f"its fields are {' '.join(fields)}, without x, y and z")
    if len(fields) > MAX_FIELDS or not set(said["SIZE"]) <= {"1", "2", "4", "8"}:
        raise ValueError(f"it has {len(fields)} fields of sizes {' '.join(said['SIZE'])[:80]}, known are 1, 2, 4 and 8")
    counts = [int(count) for count in said.get("COUNT", ["1"] * len(fields))]
    if not all(1 <= count <= HEADER_BYTES for count in counts):
        raise ValueError(f"its fields count {min(counts)} to {max(counts)} numbers a point")
    kinds = [{"F": "f", "I": "i", "U": "u"}[kind] + size for kind, size in zip(said["TYPE"], said["SIZE"], strict=True)]
    columns = [
        (f"{k}:{name}", f"<{kind}", (count,))
        for k, (name, kind, count) in enumerate(zip(fields, kinds, counts, strict=True))  # padding repeats the name "_"
    ]
    if said["DATA"][0] not in ("ascii", "binary", "binary_compressed"):
        raise ValueError(f"its data are {said['DATA'][0]!r}, known are ascii, binary and binary_compressed")
    points = int(said["POINTS"][0])
    width, height = int(said.get("WIDTH", said["POINTS"])[0]), int(said.get("HEIGHT", ["1"])[0])
    if points < 0 or width * height != points:
        raise ValueError(f"its header promises {points} points in {height} rows of {width}")
    return Header(np.dtype(columns), points, said["DATA"][0]), memoryview(content)[start:]


def _axes(header: Header) -> list[tuple[str, int, int]]:
    """Of x, y and z: its column's name, and how many numbers and how many bytes of a point come before it."""
    axes: dict[str, tuple[str, int, int]] = {}
    numbers, size = 0, 0
    for name in header.row.names or ():
        axes.setdefault(name.split(":")[1], (name, numbers, size))
        numbers, size = numbers + header.row[name].shape[0], size + header.row[name].itemsize
    return [axes["x"], axes["y"], axes["z"]]


def _text(header: Header, body: memoryview) -> Float32[np.ndarray, "P 3"]:
    each = sum(header.row[name].shape[0] for name in header.row.names or ())
    if len(body) > TEXT_BYTES:
        raise ValueError(f"a text of {len(body)} bytes; at most {TEXT_BYTES} are read, a binary file may be larger")
    if 2 * header.points * each > len(body) + 1:
        raise ValueError(f"it is cut short: its header promises {header.points} points, it holds {len(body)} bytes")
    text = decimals.Text(body)
    if len(text) != header.points * each:
        raise ValueError(f"it is cut short: its header promises {header.points} points, it holds {len(text) // each}")
    rows = np.empty((header.points, 3), dtype=np.float32)
    for row, (_, number, _) in zip(rows.T, _axes(header), strict=True):
        row[:] = _single(text.numbers(slice(number, None, each)))
    return rows


def _binary(header: Header, body: memoryview) -> Float32[np.ndarray, "P 3"]:
    wanted = header.points * header.row.itemsize
    if len(body) < wanted:
        raise ValueError(f"it is cut short: its header promises {wanted} bytes of points, it holds {len(body)}")
    rows = np.frombuffer(body, header.row, header.points)
    return np.stack([_single(rows[name][:, 0]) for name, _, _ in _axes(header)], axis=1)


def _compressed(header: Header, body: memoryview) -> Float32[np.ndarray, "P 3"]:
    """All x, then all y, and so on, packed by LZF behind their packed and unpacked sizes."""
    packed, unpacked = struct.unpack_from("<II", body)
    if unpacked > FILE_BYTES:
        raise ValueError(f"its points unpack to {unpacked} bytes; at most {FILE_BYTES} are read")
    if len(body) < 8 + packed or unpacked < header.points * header.row.itemsize:
        raise ValueError(f"it is cut short: {len(body) - 8} of {packed} packed bytes are there")
    plain = unpack_lzf(bytes(body[8 : 8 + packed]), unpacked)
    columns = [
        _single(np.frombuffer(plain, header.row[name], header.points, size * header.points)[:, 0])
        for name, _, size in _axes(header)
    ]
    return np.stack(columns, axis=1)


def _single(numbers: np.ndarray) -> Float32[np.ndarray, " P"]:
    """In single precision; what is too large becomes infinite, which is no return."""
    with np.errstate(over="ignore", invalid="ignore"):
        return numbers.astype(np.float32, copy=False)


def unpack_lzf(packed: bytes, size: int) -> bytes:
    """What Marc Lehmann's LZF packed: runs of up to 32 plain bytes, and references up to 8 kB back.

    Raises:
        ValueError: the data end too soon, refer to before their beginning, or do not give `size` bytes.
    """
    plain = bytearray()
    at = 0
    try:
        while at < len(packed) and len(plain) <= size:
            control = packed[at]
            at += 1
            if control < 32:
                plain += packed[at : at + control + 1]
                at += control + 1
                continue
            length = control >> 5
            if length == 7:
                length += packed[at]
                at += 1
            start = len(plain) - ((control & 31) << 8 | packed[at]) - 1
            at += 1
            if start < 0:
                raise ValueError("its packed data refer to before their beginning")
            pattern = plain[start : start + length + 2]
            plain += (pattern * (length // len(pattern) + 3))[: length + 2]  # it may overlap what it makes
    except IndexError as error:
        raise ValueError("its packed data end too soon") from error
    if len(plain) != size:
        raise ValueError(f"its packed data give {len(plain)} bytes, not {size}")
    return bytes(plain)
