"""Lossless packing of what the scene cache holds: half-precision maps, and arrays of any other kind.

A map after a ReLU is zero in two thirds of its entries, and nearly all others lie within sixteen octaves. So one bit an
entry says which are not zero, and of those the word (sign, exponent, mantissa) follows in 14 bits instead of 16: the
eight low ones in a byte, the six others four to three bytes. The few words outside the sixteen octaves are listed
apart. What comes back has the same bits, whatever the values; if the window does not pay, words are stored as they are.
"""

from __future__ import annotations

import math
import struct
import zlib
from itertools import accumulate
from typing import Any

import numpy as np
from jaxtyping import Float16, Shaped, UInt8, UInt16

MAP_HEAD = struct.Struct("<III")
"""Entries that are not zero, how many of them are listed apart, and the window's first high byte or `PLAIN`."""

WINDOW = 64
"""Successive high bytes of words: sixteen octaves, six bits."""

PLAIN = 256
"""Instead of the window's first high byte: words are stored as they are."""

APART = 6
"""Bytes of a word that is listed apart, with its place."""

ARRAY_HEAD = struct.Struct("<8sB")
"""Type as NumPy writes it, number of axes; the axes follow, eight bytes each."""

LARGEST = 2**26
"""Bytes that one packed array may take in memory: a file cannot ask for more."""

RAW = -zlib.MAX_WBITS  # a bare deflate stream: the file around it has checksums


def pack_map(one: Float16[np.ndarray, "C H W"]) -> bytes:
    """The bytes from which `unpack_map` makes the same map, bit for bit."""
    words = np.ascontiguousarray(one, dtype="<f2").view("<u2").ravel()
    filled = words != 0
    values = words[filled]
    first = _window(values)
    offset = values - np.uint16(first << 8)  # wraps below the window
    apart = np.flatnonzero(offset >> 8 >= WINDOW)
    if len(apart) * APART + 3 * _quarter(len(values)) > len(values):
        parts = [MAP_HEAD.pack(len(values), 0, PLAIN), np.packbits(filled), values]
    else:
        high = _pack_six((offset >> 8).astype(np.uint8) & np.uint8(WINDOW - 1))
        head = MAP_HEAD.pack(len(values), len(apart), first)
        parts = [head, np.packbits(filled), offset.astype(np.uint8), high, apart.astype("<u4"), values[apart]]
    return b"".join(part if isinstance(part, bytes) else part.tobytes() for part in parts)


def unpack_map(chunk: bytes, shape: tuple[int, int, int]) -> Float16[np.ndarray, "C H W"]:
    """The map that was packed.

    Args:
        chunk: what `pack_map` gave.
        shape: C, H, W of the map.

    Raises:
        ValueError: these bytes are no such map.
    """
    if len(chunk) < MAP_HEAD.size:
        raise ValueError(f"a packed map has at least {MAP_HEAD.size} bytes, not {len(chunk)}")
    size, (n_values, n_apart, first) = math.prod(shape), MAP_HEAD.unpack_from(chunk)
    of_values = [2 * n_values] if first == PLAIN else [n_values, 3 * _quarter(n_values), 4 * n_apart, 2 * n_apart]
    *starts, end = accumulate([MAP_HEAD.size, -(-size // 8), *of_values])
    if end != len(chunk) or n_apart > n_values or not (first == PLAIN or first + WINDOW <= PLAIN):
        raise ValueError(f"the parts of a packed map of {shape} take {end} bytes, but it has {len(chunk)}")
    bits = np.frombuffer(chunk, np.uint8, -(-size // 8), starts[0])
    filled = np.flatnonzero(np.unpackbits(bits, count=size).view(np.bool_))
    if len(filled) != n_values:
        raise ValueError(f"a packed map says that {n_values} entries are not zero, and marks {len(filled)}")
    words = np.zeros(size, np.uint16)
    if first == PLAIN:
        words[filled] = np.frombuffer(chunk, "<u2", n_values, starts[1])
        return words.view(np.float16).reshape(shape)
    values = _unpack_six(np.frombuffer(chunk, np.uint8, of_values[1], starts[2]), n_values).astype(np.uint16)
    values += np.uint16(first)
    values <<= 8
    values |= np.frombuffer(chunk, np.uint8, n_values, starts[1])
    apart = np.frombuffer(chunk, "<u4", n_apart, starts[3])
    if n_apart and int(apart.max()) >= n_values:
        raise ValueError("a packed map lists a word apart that it does not hold")
    values[apart] = np.frombuffer(chunk, "<u2", n_apart, starts[4])
    words[filled] = values
    return words.view(np.float16).reshape(shape)


def _window(values: UInt16[np.ndarray, " n"]) -> int:
    """The first of the 64 successive high bytes that most words have."""
    counts = np.bincount(values >> 8, minlength=256)
    return int(np.convolve(counts, np.ones(WINDOW, dtype=counts.dtype), mode="valid").argmax())


def _quarter(n: int) -> int:
    """A quarter of n, rounded up."""
    return -(-n // 4)


def _pack_six(numbers: UInt8[np.ndarray, " n"]) -> UInt8[np.ndarray, "3 quarter"]:
    """Numbers below 64, four to three bytes: the last quarter's bits lie above those of the three others."""
    rows = np.pad(numbers, (0, 4 * _quarter(len(numbers)) - len(numbers))).reshape(4, -1)
    return rows[:3] | (rows[3] >> np.array([[0], [2], [4]], np.uint8) & 3) << 6


def _unpack_six(code: UInt8[np.ndarray, " bytes"], n: int) -> UInt8[np.ndarray, " n"]:
    """The n numbers that were packed."""
    shared = code.reshape(3, _quarter(n))
    rows = np.empty((4, shared.shape[1]), np.uint8)
    np.bitwise_and(shared, WINDOW - 1, out=rows[:3])
    low, middle, high = shared >> 6
    rows[3] = low | middle << 2 | high << 4
    return rows.ravel()[:n]


def pack_array(array: Shaped[np.ndarray, "..."]) -> bytes:
    """The bytes from which `unpack_array` makes the same array. ValueError for one that it would refuse."""
    _check(array.dtype, array.nbytes)
    head = ARRAY_HEAD.pack(array.dtype.str.encode(), array.ndim) + struct.pack(f"<{array.ndim}Q", *array.shape)
    return head + zlib.compress(array.tobytes(), level=1, wbits=RAW)


def unpack_array(chunk: bytes) -> Shaped[np.ndarray, "..."]:
    """The array that was packed. ValueError if these bytes are no such array."""
    try:
        kind, n_axes = ARRAY_HEAD.unpack_from(chunk)
        shape = struct.unpack_from(f"<{n_axes}Q", chunk, ARRAY_HEAD.size)
        dtype = np.dtype(kind.rstrip(b"\0").decode())
    except (struct.error, TypeError, ValueError, SyntaxError) as error:
        raise ValueError(f"no packed array: {error}") from error
    size = math.prod(shape) * dtype.itemsize
    _check(dtype, size)
    raw = _inflate(chunk[ARRAY_HEAD.size + 8 * n_axes :], size)
    return np.ndarray(shape, dtype, buffer=bytearray(raw))


def _check(dtype: np.dtype[Any], size: int) -> None:
    """ValueError unless these are plain numbers that memory holds easily."""
    if dtype.kind not in "biufc" or size > LARGEST:
        raise ValueError(f"a packed array holds numbers of at most {LARGEST} bytes, not {size} bytes of {dtype}")


def _inflate(code: bytes, size: int) -> bytes:
    """The `size` bytes that were compressed; ValueError if they are more, fewer or none."""
    decoder = zlib.decompressobj(RAW)
    try:
        raw = decoder.decompress(code, size + 1)
    except zlib.error as error:
        raise ValueError(f"a compressed part cannot be read: {error}") from error
    if len(raw) != size or not decoder.eof or decoder.unused_data:
        raise ValueError(f"a compressed part should hold {size} bytes, and does not")
    return raw
