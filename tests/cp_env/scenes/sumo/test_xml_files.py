"""XML files of the simulator: plain, packed, broken, and larger than memory should be."""

from __future__ import annotations

import gzip
import tracemalloc
from pathlib import Path

import pytest

from cp_env.scenes.errors import BrokenData
from cp_env.scenes.sumo import xml_files
from cp_env.scenes.sumo.xml_files import children, parse

ROUTES = '<routes><vType id="a"/><vehicle id="1"><route edges="x y"/></vehicle><trip id="2"/></routes>'


@pytest.mark.parametrize("packed", [False, True])
def test_plain_and_packed_files_say_the_same(tmp_path: Path, packed: bool) -> None:
    path = tmp_path / ("r.rou.xml.gz" if packed else "r.rou.xml")
    path.write_bytes(gzip.compress(ROUTES.encode(), mtime=0) if packed else ROUTES.encode())
    assert [element.tag for element in parse(path)] == ["vType", "vehicle", "trip"]
    seen = [(element.tag, element.get("id"), len(element)) for element in children(path)]
    assert seen == [("vType", "a", 0), ("vehicle", "1", 1), ("trip", "2", 0)]


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("a.xml", b"<routes><trip/>", "is no XML"),
        ("a.xml", b"", "is no XML"),
        ("a.xml.gz", b"<routes/>", "is no XML"),
        ("a.xml.gz", gzip.compress(ROUTES.encode(), mtime=0)[:-12], "is no XML"),
        ("a.xml.gz", gzip.compress(ROUTES.encode(), mtime=0)[:20] + b"\xff" * 20, "is no XML"),
        ("a.xml", None, "cannot be read"),
    ],
)
def test_broken_files_are_told(tmp_path: Path, name: str, content: bytes | None, told: str) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(BrokenData, match=told):
        parse(tmp_path / name)
    with pytest.raises(BrokenData, match=told):
        list(children(tmp_path / name))


def test_a_large_file_is_read_in_little_memory(tmp_path: Path) -> None:
    """Eight megabytes of trips, packed: at most one of them is held at a time."""
    path = tmp_path / "day.rou.xml.gz"
    trip = '<trip id="v{k:06d}" depart="0.00" from="a" to="b"/>' + " " * 30
    path.write_bytes(gzip.compress(("<routes>" + trip * 100_000 + "</routes>").encode()))
    tracemalloc.start()
    try:
        assert sum(1 for _ in children(path)) == 100_000
        assert tracemalloc.get_traced_memory()[1] < 2 * 2**20
    finally:
        tracemalloc.stop()


def test_one_element_cannot_fill_the_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(xml_files, "LARGEST", 2**20)
    path = tmp_path / "bomb.rou.xml.gz"
    path.write_bytes(gzip.compress(b"<routes><vehicle>" + b"<stop/>" * 10**6 + b"</vehicle></routes>", mtime=0))
    with pytest.raises(BrokenData, match="an element of more than 1 MiB"):
        list(children(path))
