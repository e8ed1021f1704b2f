"""The pipe's bounds: whatever the process does, whoever asks goes on in time."""

from __future__ import annotations

import contextlib
import gc
import os
import signal
import sys
import time
from pathlib import Path

import pytest

from defenders.sealed import pipe
from defenders.sealed.pipe import Pipe, PipeError

ECHO = "for line in sys.stdin: print(line.strip()[::-1], flush=True)"
SILENT = "sys.stdin.readline(); time.sleep(600)"
DEAF = "time.sleep(600)"
ENDLESS = "while True: sys.stdout.write('x' * 4096); sys.stdout.flush()"
ENDS = "sys.stdin.readline(); os._exit(3)"
TORN = "sys.stdin.readline(); sys.stdout.write('half'); sys.stdout.flush(); os._exit(0)"
NO_TEXT = "sys.stdin.readline(); os.write(1, b'\\xff\\n'); time.sleep(600)"
GRANDCHILD = """
sys.stdin.readline()
if os.fork() == 0:
    os.setsid()  # leaves the group that is ended
    time.sleep(5)
    os._exit(0)
os._exit(0)
"""


def open_pipe(program: str) -> Pipe:
    return Pipe([sys.executable, "-c", f"import os, sys, time\n{program}"])


def in_time(seconds: float) -> float:
    return time.monotonic() + seconds


def test_lines_are_answered_one_by_one() -> None:
    echo = open_pipe(ECHO)
    assert [echo.exchange(word, in_time(60)) for word in ("abc", "", "grün")] == ["cba", "", "nürg"]


@pytest.mark.parametrize(
    ("program", "reason"),
    [
        (SILENT, "no answer in time, and its process was ended"),
        (ENDLESS, "more than a line can hold"),
        (ENDS, "its process ended"),
        (TORN, "its process ended"),
        (NO_TEXT, "its process ended"),
    ],
    ids=["silent", "endless", "ends", "torn", "no text"],
)
def test_whoever_asks_goes_on(program: str, reason: str) -> None:
    one = open_pipe(program)
    begin = time.monotonic()
    with pytest.raises(PipeError, match=reason):
        one.exchange("hello", in_time(2))
    assert time.monotonic() - begin < 2 + pipe.LEAVE + 8
    assert one.child.poll() is not None
    with pytest.raises(PipeError, match="its process ended"):  # at once
        one.exchange("again", in_time(60))


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no such signal here")
@pytest.mark.parametrize("program", [ECHO, SILENT, ENDS], ids=["echo", "silent", "ends"])
@pytest.mark.parametrize("killed", [False, True])
def test_it_is_known_who_was_killed_by_somebody_else(program: str, killed: bool) -> None:
    """Whom we end because it is silent was not."""
    one = open_pipe(program)
    if killed:
        one.child.kill()
    if program == ECHO and not killed:
        assert one.exchange("ab", in_time(60)) == "ba"
        one.child.terminate()
    for _ in range(2):
        with pytest.raises(PipeError) as raised:
            one.exchange("hello", in_time(1))
        assert raised.value.killed == killed


def test_a_process_that_never_reads_holds_up_nobody() -> None:
    """More than a pipe takes is to be written, and nobody reads it."""
    deaf = open_pipe(DEAF)
    begin = time.monotonic()
    with pytest.raises(PipeError, match="in time"):
        deaf.exchange("x" * (4 << 20), in_time(1))
    assert time.monotonic() - begin < 1 + pipe.LEAVE + 8 and deaf.child.poll() is not None


@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")
def test_a_child_of_its_own_that_keeps_the_pipe_open_holds_up_nobody() -> None:
    one = open_pipe(GRANDCHILD)
    begin = time.monotonic()
    with pytest.raises(PipeError, match="in time"):
        one.exchange("hello", in_time(1))
    assert time.monotonic() - begin < 1 + pipe.LEAVE + 3, "it waited for the grandchild"


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="counts descriptors in /proc")
def test_nothing_is_left_open() -> None:
    gc.collect()  # what other tests have left to be closed
    before = len(list(Path("/proc/self/fd").iterdir()))
    for program in (ECHO, SILENT, ENDS):
        one = open_pipe(program)
        if program != SILENT:
            with contextlib.suppress(PipeError):
                one.exchange("hello", in_time(60))
        child = one.child
        del one
        gc.collect()
        assert child.poll() is not None
    assert len(list(Path("/proc/self/fd").iterdir())) <= before
