"""Decimal numbers of a text, thousands at once: numpy takes sixteen characters as two integers of 64 bits.

A number of at most fifteen digits is an integer that a double holds exactly, divided by a power of ten that it holds
exactly too, so one division gives the nearest double, which is what `float` gives. Whatever else a number may look like
(an exponent, "nan", more digits) is left to `float`. Sources: W. D. Clinger, "How to read floating point numbers
accurately", PLDI 1990; eight digits in three products as in D. Lemire, "Number parsing at a gigabyte per second", 2021.

Convention: the first character of eight is the lowest byte of its integer.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int, UInt64

_BLOCK = 16384  # numbers read at once: what is made of them stays in the processor's cache
_POWER = 10 ** np.arange(17, dtype=np.uint64)
_EXACT = np.uint64(2**53)  # doubles hold all integers below
_ONES, _ZEROS, _TOPS, _NO_DIGIT, _DOTS = (
    np.uint64(0x0101010101010101 * byte) for byte in (1, ord("0"), 0x80, 0x80 - 10, ord(".") ^ ord("0"))
)
_AFTER = np.array([[0x0F0E0D0C0B0A0908], [0x0706050403020100]], dtype=np.uint64)
"""Times 256^k: the top byte is how many of the sixteen characters come after byte k of the head, or of the tail."""


class Text:
    """Words between blanks, as `bytes.split` finds them."""

    def __init__(self, text: bytes | memoryview) -> None:
        size = len(text)
        padded = np.zeros(size // 8 * 8 + 32, dtype=np.uint8)
        padded[16 : 16 + size] = np.frombuffer(text, dtype=np.uint8)
        self._eights = padded.view("<u8")
        self._text = padded[16 : 16 + size]  # the 16 characters before number k begin at byte k of the padded text
        blank = (self._text == ord(" ")) | (self._text - np.uint8(ord("\t")) < 5)
        self._words = np.flatnonzero(np.diff(blank, prepend=True, append=True)).reshape(-1, 2)

    def __len__(self) -> int:
        return len(self._words)

    def numbers(self, chosen: slice) -> Float[np.ndarray, " W"]:
        """What the words chosen stand for, each the same as `float` makes of it.

        Raises:
            ValueError: a word is no number.
        """
        words = self._words[chosen]
        numbers = np.empty(len(words))
        for start in range(0, len(words), _BLOCK):
            begin, end = words[start : start + _BLOCK].T
            block, plain = self._plain(begin, end)
            for k in np.flatnonzero(~plain):
                block[k] = float(self._text[begin[k] : end[k]].tobytes())
            numbers[start : start + _BLOCK] = block
        return numbers

    def _plain(
        self, begin: Int[np.ndarray, " B"], end: Int[np.ndarray, " B"]
    ) -> tuple[Float[np.ndarray, " B"], Bool[np.ndarray, " B"]]:
        """The numbers, and which of them are right: a sign, up to fifteen digits and one dot among them, or none."""
        sign = self._text.take(begin)
        negative = sign == ord("-")
        length = end - begin - (negative | (sign == ord("+")))
        digits, dot = _undot(self._last(end, length))
        dots = (dot != 0).sum(axis=0)
        power = _POWER.take((dot * _AFTER >> np.uint64(56)).sum(axis=0).astype(np.int64))
        head, tail = _value(digits)
        mantissa = head * _POWER[8] + tail
        mantissa -= dots.astype(np.uint64) * (mantissa // (power * _POWER[1]) * power * np.uint64(9))  # it was a 0
        plain = ((digits + _NO_DIGIT | digits) & _TOPS == 0).all(axis=0)
        plain &= (length > dots) & (length <= 16) & (dots < 2) & (mantissa < _EXACT)
        numbers = mantissa.astype(np.float64) / power.astype(np.float64)
        return np.where(negative, -numbers, numbers), plain

    def _last(self, end: Int[np.ndarray, " B"], count: Int[np.ndarray, " B"]) -> UInt64[np.ndarray, "2 B"]:
        """The sixteen characters before `end` less "0", head and tail; 0 instead of those before the last `count`."""
        at, shift = end >> 3, ((end & 7) << 3).astype(np.uint64)
        a, b, c = (self._eights.take(at + k) for k in range(3))
        back = np.uint64(64) - shift
        digits = np.stack([a >> shift | b << back, b >> shift | c << back]) ^ _ZEROS
        others = (np.stack([16 - count, 8 - count]).clip(0, 8) << 3).astype(np.uint64)
        return digits >> others << others


def _undot(digits: UInt64[np.ndarray, "2 B"]) -> tuple[UInt64[np.ndarray, "2 B"], UInt64[np.ndarray, "2 B"]]:
    """The same with a 0 for the first dot of each, and 256^k where that was byte k; 0 where there is none."""
    other = digits ^ _DOTS
    dot = (other - _ONES) & ~other & _TOPS  # the lowest of these bits is right
    dot = (dot & (~dot + np.uint64(1))) >> np.uint64(7)
    return digits ^ dot * np.uint64(ord(".") ^ ord("0")), dot


def _value(digits: UInt64[np.ndarray, "2 B"]) -> UInt64[np.ndarray, "2 B"]:
    """Eight digits as one integer."""
    pairs = (digits * np.uint64(10) + (digits >> np.uint64(8))) & np.uint64(0x00FF00FF00FF00FF)
    fours = (pairs * np.uint64(100) + (pairs >> np.uint64(16))) & np.uint64(0x0000FFFF0000FFFF)
    return (fours * np.uint64(10_000) + (fours >> np.uint64(32))) & np.uint64(0xFFFFFFFF)
