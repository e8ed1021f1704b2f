"""YAML as plain data: what is read, numpy's arrays, and every way beyond a bound refused before it is built."""

from __future__ import annotations

import contextlib
import time
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from cp_env.scenes.opv2v.bounded_yaml import MAX_BYTES, MAX_DEPTH, MAX_NODES, RefusedYaml, load

WORDS = st.text("ab <&*!", max_size=6)
LEAVES = st.none() | st.booleans() | st.integers(-(10**12), 10**12) | st.floats(allow_nan=False) | WORDS
KEYS = st.integers(0, 99) | st.text("xyz", min_size=1)
DATA = st.recursive(
    LEAVES, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(KEYS, inner, max_size=4), max_leaves=20
)


@given(DATA)
def test_plain_data_comes_back(said: Any) -> None:
    assert load(yaml.safe_dump(said)) == said


def test_by_hand() -> None:
    assert load("") is None and load("# nothing\n") is None and load("---\n") is None
    said = load("a: 1\nb: [1.5, 1e-07, -.inf, 0x1F]\nc: {3: 'no', 4: ~}\nd: yes please\n")
    assert said == {"a": 1, "b": [1.5, 1e-7, -np.inf, "0x1F"], "c": {3: "no", 4: None}, "d": "yes please"}
    assert load("a: &x {p: 1, q: 2}\nb: *x\nc: {<<: *x, q: 3}\n") == {
        "a": {"p": 1, "q": 2},
        "b": {"p": 1, "q": 2},
        "c": {"p": 1, "q": 3},
    }
    assert load("a: 1\na: 2\n") == {"a": 2} and load("v: !!float 3") == {"v": 3} and load('v: "3"') == {"v": "3"}


def test_arrays_of_numpy_as_pyyaml_writes_them() -> None:
    """V2V4Real's poses: arrays share their dtype by an alias, and what is the same array is one alias."""
    pose = np.arange(16.0).reshape(4, 4)
    said = load(
        yaml.dump({"a": pose, "b": pose, "c": np.float64(2.5), "d": np.asfortranarray(pose), "e": np.arange(3)})
    )
    assert np.array_equal(said["a"], pose) and said["b"] is said["a"] and np.array_equal(said["d"], pose)
    assert said["c"] == 2.5 and said["e"].tolist() == [0, 1, 2]
    old = yaml.dump({"a": pose}).replace("numpy._core", "numpy.core")
    assert np.array_equal(load(old)["a"], pose), "as numpy 1 writes it"


def laughs(levels: int) -> str:
    """A word ten times, that ten times, and so on."""
    lines = ["a0: &a0 [lol, lol, lol, lol, lol, lol, lol, lol, lol, lol]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]" for k in range(1, levels)]
    return "\n".join(lines)


@pytest.fixture(scope="module")
def tenth() -> float:
    """Seconds of the processor for a tenth of the values that a document may hold, on this machine."""
    begin = time.process_time()
    assert len(load("[" + "1," * (MAX_NODES // 10 - 1) + "]")) == MAX_NODES // 10 - 1
    return time.process_time() - begin


@pytest.mark.parametrize(
    ("text", "told"),
    [
        pytest.param("[" * 100_000, "nested deeper", id="lists in a row"),
        pytest.param("{" * 100_000, "nested deeper", id="maps in a row"),
        pytest.param("- " * 100_000, "nested deeper", id="entries in a row"),
        pytest.param("? " * 100_000, "nested deeper", id="keys in a row"),
        pytest.param("\n".join(" " * k + "a:" for k in range(2000)), "nested deeper", id="indented"),
        pytest.param("a: &a [" + "x, " * 10 + "*a]", "names nothing that is complete", id="itself"),
        pytest.param("a: *b", "names nothing that is complete", id="nothing"),
        pytest.param(laughs(9), "aliases counted as what they repeat", id="billion laughs"),
        pytest.param(
            "a: &a {k: 1}\n" + "".join(f"b{k}: *a\n" for k in range(MAX_NODES // 3)), "values", id="one alias"
        ),
        pytest.param("[" + "1," * MAX_NODES + "]", "values", id="long"),
        pytest.param("#" * (MAX_BYTES + 1), "at most", id="large"),
        pytest.param("a: !!python/object/apply:os.system ['exit 3']", "nothing of it is executed", id="call"),
        pytest.param("a: !!python/name:os.system ''", "nothing of it is executed", id="name"),
        pytest.param("a: !!python/object:builtins.object {}", "nothing of it is executed", id="object"),
        pytest.param("a: !mine {}", "nothing of it is executed", id="a tag of one's own"),
        pytest.param("{[1, 2]: 3}", "is a key", id="a list as a key"),
        pytest.param("a: [1, 2", "is no YAML", id="cut"),
        pytest.param("a: 1\n---\nb: 2\n", "several documents", id="two"),
        pytest.param("a: \x00", "is no YAML", id="control"),
    ],
)
def test_what_is_refused(text: str, told: str, tenth: float) -> None:
    """In no more than twice the time that the largest document takes, whatever it would have grown to."""
    begin = time.process_time()
    with pytest.raises(RefusedYaml, match=told):
        load(text)
    assert time.process_time() - begin < 20 * tenth


def test_the_depth_that_is_read() -> None:
    assert load("[" * MAX_DEPTH + "]" * MAX_DEPTH) is not None
    with pytest.raises(RefusedYaml, match="nested deeper than 32"):
        load("[" * (MAX_DEPTH + 1) + "]" * (MAX_DEPTH + 1))


@pytest.mark.parametrize(
    "change",
    [("f8", "O8"), ("- 4\n", "- 5\n"), ("state: !!python/tuple", "state: {}\n  other: !!python/tuple"), ("AAAA", "")],
)
def test_arrays_that_are_none_are_refused(change: tuple[str, str]) -> None:
    text = yaml.dump({"a": np.eye(4)})
    assert change[0] in text
    with pytest.raises(RefusedYaml, match=r"numpy cannot be read|no YAML"):
        load(text.replace(*change))


@given(st.text("[]{}&*!-?:,'\"a1 \n", max_size=60))
def test_whatever_is_written_is_read_or_refused(text: str) -> None:
    with contextlib.suppress(RefusedYaml):
        load(text)
