"""The pickle machine: what plain pickles hold is read as Python reads it; all else ends in a ValueError, soon."""

from __future__ import annotations

import collections
import io
import pickle
import pickletools
import time
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cp_env.scenes.formats.pickle_program import MAX_DEPTH, MAX_STEPS, run
from cp_env.scenes.formats.safe_pickle import MAKERS

ATOMS = st.none() | st.booleans() | st.integers(-(2**70), 2**70) | st.floats(allow_nan=False) | st.text() | st.binary()
KEYS = st.text() | st.integers()
PLAIN = st.recursive(
    ATOMS,
    lambda inner: (
        st.lists(inner, max_size=4) | st.tuples(inner, inner, inner) | st.dictionaries(KEYS, inner, max_size=4)
    ),
    max_leaves=12,
)


@given(PLAIN, st.integers(3, 5))
def test_plain_values_are_read_as_python_reads_them(value: Any, protocol: int) -> None:
    assert run(pickle.dumps(value, protocol), {}) == value


@pytest.mark.parametrize("protocol", [3, 4, 5])
@pytest.mark.parametrize("dtype", ["?", "i1", "<i4", ">i4", "<f2", "<f8", "u1"])
def test_arrays_and_numbers_are_read_as_numpy_reads_them(protocol: int, dtype: str) -> None:
    array = np.arange(6).reshape(2, 3).astype(dtype)
    content = {"a": array, "b": np.asfortranarray(array), "c": array[1, 2], "d": [array[:0], array[0, 0]], "e": array}
    back = run(pickle.dumps(content, protocol), MAKERS)
    for key in "abe":
        assert back[key].dtype == array.dtype and (back[key] == array).all()
    assert back["c"] == array[1, 2] and type(back["c"]) is type(array[1, 2])
    assert back["d"][0].shape == (0, 3) and back["a"] is back["e"]


def bomb(levels: int) -> bytes:
    """A list of two, twice, of two, twice …: a few hundred bytes that stand for 2^levels values."""
    value: Any = []
    for _ in range(levels):
        value = [value, value]
    return pickle.dumps(value)


def program(*parts: bytes) -> bytes:
    return b"\x80\x04" + b"".join(parts) + b"."


REFUSED = {
    "cut": pickle.dumps([1, 2])[:-1],
    "empty": b"",
    "nothing on the stack": b"\x80\x04.",
    "two on the stack": program(b"NN"),
    "unknown opcode": program(b"\xff"),
    "stack underflow": program(b"\x86"),
    "no mark": program(b"NNe"),
    "tuple over a mark": program(b"(N\x86"),
    "lost memory": program(b"h\x07"),
    "a class": program(b"cos\nsystem\n"),
    "a class by stack": program(b"\x8c\x02os\x8c\x06system\x93"),
    "a call of a text": program(b"\x8c\x01a)R"),
    "a state of a list": program(b"]Nb"),
    "an instance": program(b"(ios\nsystem\n"),
    "an extension": program(b"\x82\x01"),
    "a persistent id": program(b"NQ"),
    "a list as a key": program(b"}]Ns"),
    "a circle": program(b"]\x94h\x00a"),
    "deep": pickle.dumps(eval("[" * (MAX_DEPTH + 2) + "]" * (MAX_DEPTH + 2))),
    "very deep": program(b")" + b"\x85" * 50_000),
    "many values by sharing": bomb(40),
    "too many opcodes": program(b"N0" * (MAX_STEPS // 2 + 1), b"N"),
    "a long text that is not there": program(b"\x8d" + (1 << 40).to_bytes(8, "little") + b"a"),
    "a mark alone": program(b"("),
    "unfinished array": pickle.dumps(np.zeros(3))[:-2] + b"0h\x03.",
    "a type whose name is deep": program(b"cnumpy\ndtype\n()" + b"\x85" * 5000 + b"\x89\x88tR"),
    "a counter": pickle.dumps(collections.Counter("ab")),
    "a date": pickle.dumps(np.zeros(2, "M8[s]")),
    "a structure": pickle.dumps(np.zeros(2, [("a", "i4")])),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_refused_is_refused_soon(name: str) -> None:
    start = time.perf_counter()
    with pytest.raises(ValueError, match=r"."):
        run(REFUSED[name], MAKERS)
    assert time.perf_counter() - start < 3


def test_objects_are_never_made_of_raw_bytes() -> None:
    """Bytes that are taken for addresses of objects crash the interpreter as soon as one is looked at."""
    module, raw = b"cnumpy._core.multiarray\n", b"C\x08" + b"AAAAAAAA"
    dtype = b"cnumpy\ndtype\n(X\x02\x00\x00\x00O8I00\nI01\ntR".replace(b"I00\n", b"\x89").replace(b"I01\n", b"\x88")
    dtype += b"(K\x03X\x01\x00\x00\x00|NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK?tb"
    array = module + b"_reconstruct\ncnumpy\nndarray\nK\x00\x85C\x01b\x87R"
    for body in (
        module + b"scalar\n" + dtype + raw + b"\x86R",
        b"cnumpy._core.numeric\n_frombuffer\n(" + raw + dtype + b"K\x01\x85X\x01\x00\x00\x00CtR",
        array + b"(K\x01K\x01\x85" + dtype + b"\x89" + raw + b"tb",
    ):
        pickletools.dis(program(body), out=io.StringIO())  # a real pickle
        with pytest.raises(ValueError, match=r"objects that are not listed|a number without a type"):
            run(program(body), MAKERS)
    listed = run(program(array + b"(K\x01K\x02\x85" + dtype + b"\x89](K\x07\x8c\x01aetb"), MAKERS)
    assert listed.dtype == object and listed.tolist() == [7, "a"]
