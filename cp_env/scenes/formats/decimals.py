"""Decimal numbers of a text, thousands at once: numpy takes eight characters as an integer of 64 bits.

A number of at most fifteen digits is an integer that a double holds exactly, divided by a power of ten that it holds
exactly too, so one division gives the nearest double, which is what `float` gives. Whatever else a number may look like
(an exponent, "nan", more digits) is left to `float`. Sources: W. D. Clinger, "How to read floating point numbers
accurately", PLDI 1990; eight digits in three products as in D. Lemire, "Number parsing at a gigabyte per second", 2021.

Most numbers of a point cloud take up to eight characters behind their sign. Longer ones are read once more, as sixteen.

Convention: the first character of eight is the lowest byte of its integer.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int, UInt64

_BLOCK = 16384  # numbers read at once: what is made of them stays in the processor's cache
_SCANNED = 1 << 18  # characters looked through at once
_LONGEST = 1 << 31  # characters whose places fit 32 bits
_POWER = 10 ** np.arange(17, dtype=np.uint64)
_EXACT = np.uint64(2**53)  # doubles hold all integers below
_ONES, _ZEROS, _TOPS, _NO_DIGIT, _DOTS = (
    np.uint64(0x0101010101010101 * byte) for byte in (1, ord("0"), 0x80, 0x80 - 10, ord(".") ^ ord("0"))
)
_BLANK = np.isin(np.arange(256), [ord(blank) for blank in " \t\n\v\f\r"])
"""Which bytes are blanks, as `bytes.split` has it."""
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
        ends = self._apart() if size < _LONGEST else None
        self._after = int(ends is not None)  # words begin so far behind `_begin`
        self._begin, self._end = self._words() if ends is None else (ends[:-1], ends[1:])

    def __len__(self) -> int:
        return len(self._begin)

    def numbers(self, chosen: slice) -> Float[np.ndarray, " W"]:
        """What the words chosen stand for, each the same as `float` makes of it.

        Raises:
            ValueError: a word is no number.
        """
        begins, ends = self._begin[chosen], self._end[chosen]
        numbers = np.empty(len(begins))
        for start in range(0, len(begins), _BLOCK):
            begin = begins[start : start + _BLOCK].astype(np.int64) + self._after
            end = ends[start : start + _BLOCK].astype(np.int64)
            block, plain = self._plain(begin, end)
            for k in np.flatnonzero(~plain):
                block[k] = float(self._text[begin[k] : end[k]].tobytes())
            numbers[start : start + _BLOCK] = block
        return numbers

    def _apart(self) -> Int[np.ndarray, " E"] | None:
        """−1 and where words end, if one blank follows each and none comes first; None if it is not so simple."""
        ends, last = [np.array([-1], dtype=np.int32)], -1
        for start in range(0, len(self._text), _SCANNED):
            part = self._text[start : start + _SCANNED]
            end = np.flatnonzero(part <= ord(" "))
            if len(end):
                crowded = end[0] + start == last + 1 or (np.diff(end) == 1).any()
                if crowded or not _BLANK.take(part.take(end)).all():
                    return None
                last = int(end[-1]) + start
                ends.append((end + start).astype(np.int32))
        return np.concatenate(ends) if last == len(self._text) - 1 else None

    def _words(self) -> tuple[Int[np.ndarray, " W"], Int[np.ndarray, " W"]]:
        """Where words begin and end."""
        edges = np.flatnonzero(np.diff(_BLANK.take(self._text), prepend=True, append=True))
        return edges[::2], edges[1::2]

    def _plain(
        self, begin: Int[np.ndarray, " B"], end: Int[np.ndarray, " B"]
    ) -> tuple[Float[np.ndarray, " B"], Bool[np.ndarray, " B"]]:
        """The numbers, and which of them are right: a sign, up to fifteen digits and one dot among them, or none."""
        sign = self._text.take(begin)
        negative = sign == ord("-")
        length = end - begin - (negative | (sign == ord("+")))
        numbers, plain = self._short(end, length)
        long = np.flatnonzero(length > 8)
        if len(long):
            numbers[long], plain[long] = self._long(end[long], length[long])
        return np.where(negative, -numbers, numbers), plain

    def _short(
        self, end: Int[np.ndarray, " B"], length: Int[np.ndarray, " B"]
    ) -> tuple[Float[np.ndarray, " B"], Bool[np.ndarray, " B"]]:
        """The last `length` characters before `end` as numbers without a sign; right up to eight."""
        at, shift = (end >> 3) + 1, ((end & 7) << 3).astype(np.uint64)
        digits = (self._eights.take(at) >> shift | self._eights.take(at + 1) << np.uint64(64) - shift) ^ _ZEROS
        others = ((8 - length).clip(0, 8) << 3).astype(np.uint64)
        digits, dot = _undot(digits >> others << others)
        dots = dot != 0
        mantissa = _value(digits)
        if len(dot) and (dot == dot[0]).all():  # as many decimals everywhere: dividing by one number is faster
            power = _POWER[(dot[:1] * _AFTER[1] >> np.uint64(56)).astype(np.int64)]
        else:
            power = _POWER.take((dot * _AFTER[1] >> np.uint64(56)).astype(np.int64))
        above = mantissa // (power * _POWER[1]) * power * np.uint64(9)
        mantissa -= np.where(dots, above, np.uint64(0))  # the dot was a 0
        plain = ((digits + _NO_DIGIT | digits) & _TOPS == 0) & (length > dots) & (length <= 8)
        return mantissa.astype(np.float64) / np.asarray(power).astype(np.float64), plain

    def _long(
        self, end: Int[np.ndarray, " B"], length: Int[np.ndarray, " B"]
    ) -> tuple[Float[np.ndarray, " B"], Bool[np.ndarray, " B"]]:
        """The same for up to sixteen characters."""
        digits, dot = _undot(self._last(end, length))
        dots = (dot != 0).sum(axis=0)
        power = _POWER.take((dot * _AFTER >> np.uint64(56)).sum(axis=0).astype(np.int64))
        head, tail = _value(digits)
        mantissa = head * _POWER[8] + tail
        mantissa -= dots.astype(np.uint64) * (mantissa // (power * _POWER[1]) * power * np.uint64(9))  # it was a 0
        plain = ((digits + _NO_DIGIT | digits) & _TOPS == 0).all(axis=0)
        plain &= (length > dots) & (length <= 16) & (dots < 2) & (mantissa < _EXACT)
        return mantissa.astype(np.float64) / power.astype(np.float64), plain

    def _last(self, end: Int[np.ndarray, " B"], count: Int[np.ndarray, " B"]) -> UInt64[np.ndarray, "2 B"]:
        """The sixteen characters before `end` less "0", head and tail; 0 instead of those before the last `count`."""
        at, shift = end >> 3, ((end & 7) << 3).astype(np.uint64)
        a, b, c = (self._eights.take(at + k) for k in range(3))
        back = np.uint64(64) - shift
        digits = np.stack([a >> shift | b << back, b >> shift | c << back]) ^ _ZEROS
        others = (np.stack([16 - count, 8 - count]).clip(0, 8) << 3).astype(np.uint64)
        return digits >> others << others


def _undot(digits: UInt64[np.ndarray, "*n"]) -> tuple[UInt64[np.ndarray, "*n"], UInt64[np.ndarray, "*n"]]:
    """The same with a 0 for the first dot of each, and 256^k where that was byte k; 0 where there is none."""
    other = digits ^ _DOTS
    dot = (other - _ONES) & ~other & _TOPS  # the lowest of these bits is right
    dot = (dot & (~dot + np.uint64(1))) >> np.uint64(7)
    return digits ^ dot * np.uint64(ord(".") ^ ord("0")), dot


def _value(digits: UInt64[np.ndarray, "*n"]) -> UInt64[np.ndarray, "*n"]:
    """Eight digits as one integer."""
    pairs = (digits * np.uint64(10) + (digits >> np.uint64(8))) & np.uint64(0x00FF00FF00FF00FF)
    fours = (pairs * np.uint64(100) + (pairs >> np.uint64(16))) & np.uint64(0x0000FFFF0000FFFF)
    return (fours * np.uint64(10_000) + (fours >> np.uint64(32))) & np.uint64(0xFFFFFFFF)
