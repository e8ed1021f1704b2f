"""Numbers of a text are what `float` makes of them, word by word."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cp_env.scenes.formats import decimals
from cp_env.scenes.formats.decimals import Text

PLAIN = st.from_regex(r"[+-]?([0-9]{1,17}(\.[0-9]{0,17})?|\.[0-9]{1,17})", fullmatch=True)
UNUSUAL = st.floats().map(repr) | st.sampled_from(["nan", "-inf", "1e5", "-2.5E-3", "1_000", "9007199254740993"])


def slowly(text: bytes) -> list[float]:
    return [float(word) for word in text.split()]


def same(a: list[float], b: list[float]) -> bool:
    """To the last bit; -0 is not 0."""
    return np.array_equal(np.array(a).view(np.uint64), np.array(b).view(np.uint64))


@given(st.lists(PLAIN | UNUSUAL, max_size=30), st.sampled_from([" ", "\n", "\t ", "\r\n", "\x0b\x0c"]))
def test_every_number_is_that_of_float(words: list[str], blank: str) -> None:
    text = blank.join(words).encode()
    read = Text(text)
    assert len(read) == len(words)
    assert same(read.numbers(slice(None)).tolist(), slowly(text))


@given(
    st.lists(st.tuples(PLAIN | UNUSUAL, st.sampled_from(" \n\t\r\x0b\x0c")), max_size=30),
    st.sampled_from([1, 7, 64]),
    st.sampled_from(["", " ", "\x1c", "\0"]),
)
def test_one_blank_behind_each_word(words: list[tuple[str, str]], scanned: int, more: str) -> None:
    """As a point cloud has them. One blank too many, or what only looks like one, changes nothing about the words."""
    text = ("".join(word + blank for word, blank in words) + more).encode()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(decimals, "_SCANNED", scanned)
        read = Text(text)
    assert len(read) == len(text.split())
    if more not in ("\x1c", "\0"):
        assert same(read.numbers(slice(None)).tolist(), slowly(text))
        assert same(read.numbers(slice(1, None, 3)).tolist(), slowly(text)[1::3])


def test_long_texts_are_read_in_blocks() -> None:
    rng = np.random.default_rng(0)
    words = [
        f"{x:.{int(digits)}g}" for x, digits in zip(rng.normal(0, 50, 50_000), rng.integers(1, 18, 50_000), strict=True)
    ]
    read = Text(" ".join(words).encode())
    for start in range(4):
        assert same(read.numbers(slice(start, None, 4)).tolist(), [float(word) for word in words[start::4]])


@pytest.mark.parametrize(
    ("word", "number"),
    [("-0.00000", -0.0), ("12345678.1234567", 12345678.1234567), ("1.", 1.0), (".5", 0.5), ("00000000000000012", 12.0)],
)
def test_by_hand(word: str, number: float) -> None:
    (told,) = Text(f"7 {word}".encode()).numbers(slice(1, None))
    assert told == number and math.copysign(1, told) == math.copysign(1, number)


@pytest.mark.parametrize(
    "word",
    ["-", "+", ".", "-.", "--5", "1-2", "1.2.3", "1.2345678.9", "192.168.10.12", "abc", "0x10", "1,5", "é", "5\0"],
)
def test_what_is_no_number_is_told(word: str) -> None:
    with pytest.raises(ValueError, match="could not convert"):
        Text(word.encode()).numbers(slice(None))
