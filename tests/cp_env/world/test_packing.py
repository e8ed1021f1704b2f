"""What is packed comes back with the same bits; what was never packed is refused."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cp_env.world.packing import (
    ARRAY_HEAD,
    LARGEST,
    MAP_HEAD,
    PLAIN,
    pack_array,
    pack_map,
    unpack_array,
    unpack_map,
)


def rectified(shape: tuple[int, int, int], seed: int = 0) -> np.ndarray:
    """A map as a ReLU leaves it."""
    return np.random.default_rng(seed).normal(-0.4, 1.0, shape).clip(0).astype(np.float16)


def words(*values: int) -> np.ndarray:
    """A map of one channel and row with these words."""
    return np.array(values, np.uint16).view(np.float16).reshape(1, 1, -1)


@pytest.mark.parametrize("shape", [(128, 32, 32), (3, 5, 7), (1, 1, 1), (2, 300, 300)])
def test_a_map_comes_back(shape: tuple[int, int, int]) -> None:
    packed = pack_map(one := rectified(shape))
    again = unpack_map(packed, shape)
    assert again.dtype == np.float16 and again.tobytes() == one.tobytes()


@given(st.lists(st.integers(0, 2**16 - 1) | st.integers(0x3000, 0x3FFF) | st.just(0), min_size=1, max_size=80))
def test_any_bits_come_back(values: list[int]) -> None:
    """Negative zeros, subnormals, infinities and NaN with their payload among them."""
    one = words(*values)
    assert unpack_map(pack_map(one), one.shape).tobytes() == one.tobytes()


def test_the_bytes_are_these() -> None:
    """By hand: 0, 1.0 (0x3c00), 2.0 (0x4000), 0, 0.5 (0x3801) and 1.5 (0x3e00).

    The high bytes 3c, 40, 38, 3e lie in the windows of 64 that begin at 01 to 38; the first of them is taken. Less 01
    they are 3b, 3f, 37, 3d. A quarter of four numbers is one: the last, 3d = 11 11 01, gives two bits to each byte.
    """
    one = words(0, 0x3C00, 0x4000, 0, 0x3801, 0x3E00)
    high = [0b01 << 6 | 0x3B, 0b11 << 6 | 0x3F, 0b11 << 6 | 0x37]
    expected = MAP_HEAD.pack(4, 0, 1) + bytes([0b01101100, 0, 0, 1, 0, *high])
    assert pack_map(one) == expected


def test_the_bytes_of_words_outside_the_window_are_these() -> None:
    """Among few numbers a list of them, six bytes each, does not pay, and words are stored as they are."""
    one = words(0, 0x3C00, 0x4000, 0, 0x3800, 0x8000)
    filled = bytes([0b01101100])
    as_they_are = MAP_HEAD.pack(4, 0, PLAIN) + filled + struct.pack("<4H", 0x3C00, 0x4000, 0x3800, 0x8000)
    high = [0b11 << 6 | 0x3B, 0b11 << 6 | 0x3F, 0b11 << 6 | 0x37]  # 80 - 01 = 7f keeps its six low bits, 11 11 11
    listed = MAP_HEAD.pack(4, 1, 1) + filled + bytes([0, 0, 0, 0, *high]) + struct.pack("<IH", 3, 0x8000)
    assert pack_map(one) == as_they_are
    for packed in (as_they_are, listed):
        assert unpack_map(packed, (1, 1, 6)).tobytes() == one.tobytes()
    many = words(*[0x3C00] * 100, 0x8000)
    assert len(pack_map(many)) == MAP_HEAD.size + 13 + 101 + 3 * 26 + 6


def test_a_map_after_a_relu_takes_less_than_half() -> None:
    """One bit an entry, 14 bits an entry that is not zero; a signed map takes a bit an entry more than as it is."""
    one = rectified((128, 32, 32))
    filled = np.count_nonzero(one)
    assert filled / one.size < 0.36
    assert len(pack_map(one)) <= one.size / 8 + filled * 14 / 8 + 600
    signed = np.random.default_rng(0).normal(size=one.shape).astype(np.float16)
    assert len(pack_map(signed)) <= signed.nbytes + one.size / 8 + 100


@pytest.mark.parametrize("one", [rectified((4, 6, 6)), words(0x3C00, 0xBC00, 0x0001, 0x7C00)], ids=["window", "plain"])
def test_a_map_that_was_changed_is_refused_or_another(one: np.ndarray) -> None:
    """No byte that is changed, cut or added makes anything but a map or a ValueError."""
    packed = pack_map(one)
    for size in range(len(packed)):
        with pytest.raises(ValueError, match="packed map"):
            unpack_map(packed[:size], one.shape)
    with pytest.raises(ValueError, match="parts of a packed map"):
        unpack_map(packed + b"\0", one.shape)
    refused = 0
    for at in range(len(packed)):
        changed = packed[:at] + bytes([packed[at] ^ 0xFF]) + packed[at + 1 :]
        try:
            assert unpack_map(changed, one.shape).shape == one.shape
        except ValueError:
            refused += 1
    assert refused >= MAP_HEAD.size


@pytest.mark.parametrize(
    "array",
    [np.arange(12, dtype=np.uint8).reshape(3, 4), np.array(2.5, np.float32), np.zeros((0, 3)), np.ones(5, bool)],
)
def test_an_array_comes_back(array: np.ndarray) -> None:
    again = unpack_array(pack_array(array))
    assert again.dtype == array.dtype and again.shape == array.shape and again.tobytes() == array.tobytes()


def test_arrays_that_cannot_be_packed() -> None:
    for array in (np.array([object()]), np.zeros(2, [("x", "i4")]), np.zeros(LARGEST + 1, np.uint8)):
        with pytest.raises(ValueError, match="a packed array holds numbers of at most"):
            pack_array(array)


def hostile(kind: bytes, *axes: int) -> bytes:
    return ARRAY_HEAD.pack(kind, len(axes)) + struct.pack(f"<{len(axes)}Q", *axes)


@pytest.mark.parametrize(
    "chunk",
    [
        b"",
        b"nothing at all, but long enough for a head",
        hostile(b"|O", 3),
        hostile(b"<f8", 2**40),
        hostile(b"<f8", 2**40, 0, 2**40),
        hostile(b"i4,i4", 3),
        ARRAY_HEAD.pack(b"|u1", 255),
        hostile(b"|u1", 4) + b"\xff\xff",
        pack_array(np.zeros(100))[:-3],
        hostile(b"|u1", 5) + pack_array(np.zeros(4, np.uint8))[ARRAY_HEAD.size + 8 :],
        hostile(b"|u1", 3) + pack_array(np.zeros(4, np.uint8))[ARRAY_HEAD.size + 8 :],
    ],
)
def test_no_array_is_made_of_other_bytes(chunk: bytes) -> None:
    with pytest.raises(ValueError, match=r"packed array|compressed part|dimension"):
        unpack_array(chunk)
