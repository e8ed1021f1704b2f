"""Tables of the set, read in chunks."""

from __future__ import annotations

import json
import tracemalloc
from pathlib import Path

import pytest

from cp_env.scenes.errors import BrokenData
from cp_env.scenes.v2xsim import tables


@pytest.mark.parametrize("chunk", [1, 7, 1000])
def test_records_do_not_depend_on_the_chunks_they_are_read_in(
    thin: Path, monkeypatch: pytest.MonkeyPatch, chunk: int
) -> None:
    monkeypatch.setattr(tables, "_CHUNK", chunk)
    for name in ("scene", "sensor", "instance"):
        expected = json.loads((thin / "v2.0" / f"{name}.json").read_text())
        read = tables.Tables(thin / "v2.0", progress=False).read(name, *expected[0])
        assert list(read) == [list(record.values()) for record in expected]


def test_a_large_table_takes_little_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tables, "_CHUNK", 1 << 16)
    for name in tables.TABLES:
        (tmp_path / f"{name}.json").write_text("[]")
    record = {"token": "0" * 32, "translation": [1.5, 2.5, 3.5], "rotation": [1.0, 0.0, 0.0, 0.0]}
    (tmp_path / "ego_pose.json").write_text(json.dumps([record] * 5_000, indent=1))
    size = (tmp_path / "ego_pose.json").stat().st_size
    tracemalloc.start()
    assert sum(1 for _ in tables.Tables(tmp_path, progress=False).read("ego_pose", "token")) == 5_000
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < size < 5e6  # as objects it would take five times its size


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[" * 100_000, "nested too deeply"),
        ('[{"token": ' + "[" * 100_000, "nested too deeply"),
        ('[{"token": ' + "9" * 5000 + "}]", "limit"),
        ('[{"token": "' + "a" * 5_000_000, "a record of more than 1048576 characters"),
        ('[{"token": 1}, x' + " " * 5_000_000, "a record of more than 1048576 characters"),
        ('[{"token": 1}', "cut short"),
        ('{"token": 1}', "no.* JSON list|not hold a JSON list"),
        ("[1]", "record 0 is 1"),
        ('["' + "a" * 100_000 + '"]', "record 0 is 'aaa"),
    ],
)
def test_tables_that_no_memory_would_hold_are_named(tmp_path: Path, text: str, reason: str) -> None:
    for name in tables.TABLES:
        (tmp_path / f"{name}.json").write_text("[]")
    (tmp_path / "scene.json").write_text(text)
    tracemalloc.start()
    with pytest.raises(BrokenData, match=reason) as caught:
        list(tables.Tables(tmp_path, progress=False).read("scene", "token"))
    assert tracemalloc.get_traced_memory()[1] < 50e6
    tracemalloc.stop()
    assert caught.value.file == tmp_path / "scene.json" and len(str(caught.value)) < 400
