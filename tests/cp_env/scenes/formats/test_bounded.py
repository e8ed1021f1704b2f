"""Files and JSON within bounds: what is larger, deeper or named twice is refused before it is built."""

from __future__ import annotations

import json
import os
import time
import tracemalloc
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cp_env.scenes.formats.bounded import JSON_BYTES, JSON_DEPTH, check_depth, parse_json, read_bytes

PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=12,
)


@given(PLAIN)
def test_what_json_says_comes_back(value: Any) -> None:
    text = json.dumps(value)
    assert parse_json(text) == parse_json(text.encode()) == value


def nested(depth: int, value: Any = "]") -> Any:
    for _ in range(depth):
        value = [value]
    return value


def test_depth_is_counted_outside_strings() -> None:
    assert parse_json(json.dumps(nested(JSON_DEPTH))) == nested(JSON_DEPTH)
    with pytest.raises(ValueError, match=f"deeper than {JSON_DEPTH} levels"):
        parse_json(json.dumps(nested(JSON_DEPTH + 1)))
    check_depth(json.dumps(["[" * 99, '\\"' + "{" * 99, "\\"]))
    assert parse_json('{"a": {"b": 1}}', depth=2) == {"a": {"b": 1}}
    with pytest.raises(ValueError, match="deeper than 1"):
        parse_json('{"a": {"b": 1}}', depth=1)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[" * 100_000, "nested deeper"),
        ('{"a":' * 100_000, "nested deeper"),
        ('{"a": 1, "b": 2, "a": 3}', "'a' is named twice"),
        (" " * (JSON_BYTES + 1), "at most"),
        ("9" * 5000, "limit"),
        (b'"\xff"', "utf-8"),
        ('"' + '\\"' * 100_000, "Unterminated"),
        ("", "Expecting value"),
    ],
)
def test_json_that_is_refused_at_once(text: str | bytes, message: str) -> None:
    start = time.perf_counter()
    with pytest.raises(ValueError, match=message):
        parse_json(text)
    assert time.perf_counter() - start < 2


def test_a_file_is_measured_before_it_is_read(tmp_path: Path) -> None:
    file = tmp_path / "large"
    with file.open("wb") as out:
        out.truncate(10 << 30)  # a hole
    tracemalloc.start()
    with pytest.raises(ValueError, match=r"holds 10737418240 bytes; at most 1024 are read"):
        read_bytes(file, 1024)
    assert tracemalloc.get_traced_memory()[1] < 1 << 20
    tracemalloc.stop()
    (tmp_path / "small").write_bytes(b"x" * 1024)
    assert read_bytes(tmp_path / "small", 1024) == b"x" * 1024
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero"), tmp_path):
        with pytest.raises(ValueError, match="no regular file"):
            read_bytes(path, 1024)
