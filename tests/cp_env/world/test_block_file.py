"""Blocks of chunks on disk: whole or not at all, and no change of a byte goes unnoticed."""

from __future__ import annotations

from pathlib import Path

import pytest

from cp_env.scenes.errors import BrokenData
from cp_env.world import block_file
from cp_env.world.block_file import DRAFT, MAGIC, read_chunk, write_block

CHUNKS = [b"first", b"", b"the third \x00\xff"]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "new" / "folder" / "block.maps"
    assert write_block(path, CHUNKS) == path.stat().st_size
    return path


def test_each_chunk_is_read_by_its_number(path: Path) -> None:
    assert [read_chunk(path, i, 3) for i in range(3)] == CHUNKS
    assert path.read_bytes().startswith(MAGIC)
    write_block(path, [b"other"])
    assert read_chunk(path, 0, 1) == b"other", "the last writer wins"
    assert list(path.parent.iterdir()) == [path], "no draft is left"


def test_no_changed_bit_goes_unnoticed(path: Path) -> None:
    """Whichever byte is changed, at least the chunk that it is of cannot be read; the others come back as they were."""
    whole = path.read_bytes()
    for at in range(len(whole)):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 1 << at % 8]) + whole[at + 1 :])
        broken = 0
        for number, chunk in enumerate(CHUNKS):
            try:
                assert read_chunk(path, number, 3) == chunk
            except BrokenData:
                broken += 1
        assert broken >= 1


def test_a_file_that_was_cut_or_grew(path: Path) -> None:
    whole = path.read_bytes()
    for size in range(len(whole)):
        path.write_bytes(whole[:size])
        with pytest.raises(BrokenData, match=r"block.maps: (its head is not as it was written|it has \d+ bytes, not)"):
            read_chunk(path, 0, 3)
    path.write_bytes(whole + b"x")
    with pytest.raises(BrokenData, match=f"it has {len(whole) + 1} bytes, not {len(whole)}"):
        read_chunk(path, 0, 3)


def test_a_file_of_another_number_of_frames(path: Path) -> None:
    write_block(path, CHUNKS[:2])
    with pytest.raises(BrokenData):
        read_chunk(path, 0, 3)
    with pytest.raises(BrokenData):
        read_chunk(path, 0, 1)


def test_a_file_cannot_fill_the_memory(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(block_file, "LONGEST", max(map(len, CHUNKS)))
    assert read_chunk(path, 2, 3) == CHUNKS[2]
    monkeypatch.setattr(block_file, "LONGEST", max(map(len, CHUNKS)) - 1)
    with pytest.raises(BrokenData, match="a frame takes more than"):
        read_chunk(path, 0, 3)


def test_no_file(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        read_chunk(tmp_path / "none.maps", 0, 3)


def test_a_writing_that_fails_leaves_nothing(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    before = path.read_bytes()
    monkeypatch.setattr(Path, "replace", full)
    with pytest.raises(OSError, match="No space left"):
        write_block(path, [b"new"])
    assert path.read_bytes() == before and not list(path.parent.glob(f"{DRAFT}*"))
