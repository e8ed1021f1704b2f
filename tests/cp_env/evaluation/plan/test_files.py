"""Files appear whole or not at all, and where they cannot be written one sentence says so."""

from __future__ import annotations

import multiprocessing
import os
import resource
import signal
import time
from pathlib import Path

import pytest

from cp_env.evaluation.plan import files
from cp_env.evaluation.plan.files import CannotWrite, check_writable, remove_drafts, write_atomically


def test_a_file_is_written_whole(tmp_path: Path) -> None:
    path = tmp_path / "new" / "file.json"
    write_atomically(path, "ä")
    write_atomically(path, b"again")
    check_writable(tmp_path / "new")
    assert path.read_bytes() == b"again" and list(path.parent.iterdir()) == [path]


def test_a_full_disk_leaves_what_was_there(tmp_path: Path) -> None:
    """A limit on the size of files stands for the disk: the system refuses in the midst of writing."""
    path = tmp_path / "file.json"
    write_atomically(path, "before")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        with pytest.raises(CannotWrite, match=r"cannot write .*file\.json \(File too large\): make room"):
            write_atomically(path, "x" * 100_000)
        with pytest.raises(CannotWrite, match="cannot write"):
            check_writable(tmp_path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert path.read_text() == "before" and list(tmp_path.iterdir()) == [path]


def test_what_stands_in_the_place_is_named(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("a file")
    (tmp_path / "folder.json").mkdir()
    for path in (tmp_path / "out" / "runs" / "a.json", tmp_path / "folder.json", Path("/proc/nowhere/a.json")):
        with pytest.raises(ValueError, match=r"cannot write .*: make room, or give another folder"):
            write_atomically(path, "x")
    assert {path.name for path in tmp_path.iterdir()} == {"out", "folder.json"}


@pytest.mark.skipif(os.geteuid() == 0, reason="the administrator may write everywhere")
def test_a_folder_that_is_read_only_is_named(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(CannotWrite, match="Permission denied"):
        check_writable(tmp_path)
    tmp_path.chmod(0o700)


def _write_for_ever(path: Path) -> None:
    while True:
        write_atomically(path, b"x" * 5_000_000)


def test_drafts_of_killed_writers_go_and_those_of_living_ones_stay(tmp_path: Path) -> None:
    path = tmp_path / "file.json"
    writer = multiprocessing.get_context("spawn").Process(target=_write_for_ever, args=(path,))
    writer.start()
    assert writer.pid is not None
    deadline = time.monotonic() + 300  # a busy machine takes its time to start the writer
    while not (drafts := list(tmp_path.glob(f".*{files.DRAFT}"))):
        assert time.monotonic() < deadline
    os.kill(writer.pid, signal.SIGSTOP)
    drafts = [draft for draft in tmp_path.glob(f".*{files.DRAFT}") if draft.exists()]
    assert remove_drafts(tmp_path) == []
    os.kill(writer.pid, signal.SIGKILL)
    writer.join()
    assert remove_drafts(tmp_path) == drafts
    assert not list(tmp_path.glob(f".*{files.DRAFT}"))
    other = tmp_path / f".file.json.elsewhere.1{files.DRAFT}"
    other.touch()
    assert remove_drafts(tmp_path) == []
    os.utime(other, (0, 0))
    assert remove_drafts(tmp_path) == [other]
