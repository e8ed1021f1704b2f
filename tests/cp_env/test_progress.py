"""A bar on a terminal, lines by the clock elsewhere."""

from __future__ import annotations

import io
import threading
import time

import pytest

from cp_env.progress import Progress, duration, say, track


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


class Clock:
    """A clock that is moved by hand."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.mark.parametrize(("seconds", "text"), [(0, "0:00"), (59.6, "1:00"), (187, "3:07"), (3720, "1:02:00")])
def test_durations(seconds: float, text: str) -> None:
    assert duration(seconds) == text


def test_a_line_says_how_far_and_how_long() -> None:
    """Worked by hand: 10 of 40 steps were there before; 5 more in 100 s, so 25 take 500 s."""
    clock, stream = Clock(), io.StringIO()
    progress = Progress("playing", 40, "run", initial=10, stream=stream, clock=clock, first=1e9)
    with progress:
        assert progress.line() == "playing: 10 of 40 runs after 0:00"
        clock.now = 100.0
        progress.advance(5, "prbi against pgd")
        assert progress.line() == "playing: 15 of 40 runs after 1:40, about 8:20 left; prbi against pgd"
        progress.to(40)
        assert progress.line() == "playing: 40 of 40 runs after 1:40, about 0:00 left"
    unknown = Progress("reading", None, "scene", clock=clock)
    assert unknown.line() == "reading: 0 scenes after 0:00"


def test_a_long_step_is_not_silent_and_a_short_one_says_nothing() -> None:
    stream = io.StringIO()
    with Progress("training", 2, stream=stream, first=0.01, every=0.01):
        until = time.monotonic() + 10
        while stream.getvalue().count("training: 0 of 2 steps after") < 3 and time.monotonic() < until:
            time.sleep(0.005)
    told = stream.getvalue().splitlines()
    assert len(told) > 3 and told[-1].startswith("training: 0 steps in 0:0")
    short = io.StringIO()
    with Progress("training", 2, stream=short):
        pass
    assert short.getvalue() == "" and threading.active_count() < 10


def test_the_thread_ends_with_an_error_and_says_no_end() -> None:
    before, stream = threading.active_count(), io.StringIO()
    with pytest.raises(RuntimeError), Progress("playing", 2, stream=stream, first=0.0, every=1e9):
        raise RuntimeError
    assert threading.active_count() == before and " in " not in stream.getvalue()


def test_a_bar_on_a_terminal() -> None:
    stream = Terminal()
    with Progress("playing", 4, "run", stream=stream, first=0.0) as progress:
        progress.advance(3, "the last")
        say("a line of its own", stream)
    assert "playing" in stream.getvalue() and "3/4" in stream.getvalue() and "after" not in stream.getvalue()


def test_tracked_items_are_the_items() -> None:
    assert list(track((i * i for i in range(4)), "squares")) == [0, 1, 4, 9]
    assert list(track([], "nothing")) == []
