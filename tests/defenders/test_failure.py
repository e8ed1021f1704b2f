"""What is reported of a failing plug-in: its own file, line and frames, and nothing that a plug-in can misuse."""

from __future__ import annotations

import importlib
import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import defenders
from defenders.failure import MAX_REASON, MAX_TRACE, OURS, Failure, RemoteError, blamed, failure_of, one_line, paused_at
from defenders.simulation.world import play

MINE = """
import json


def act(level):
    return scaled(level)


def scaled(level):
    return level / 0


def parse():
    return json.loads("{")


def deep(n):
    return deep(n - 1) if n else 1 / 0


def asks():
    yield 1
    yield from more()


def more():
    yield 2


class Hostile(Exception):
    def __str__(self):
        raise RuntimeError("no text")
"""


@pytest.fixture
def mine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """A module of somebody's in the current folder."""
    (tmp_path / "plug_in_mine.py").write_text(MINE)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.chdir(tmp_path)
    yield importlib.import_module("plug_in_mine")
    sys.modules.pop("plug_in_mine", None)


def told(raising: Callable[[], Any]) -> Failure:
    """The failure of a call; the tests are no plug-in."""
    try:
        raising()
    except Exception as error:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("defenders.failure.OURS", (*OURS, Path(__file__).parent))
            return failure_of(error)
    raise AssertionError


def test_the_plug_ins_own_line_is_named(mine: ModuleType) -> None:
    failure = told(lambda: mine.act(1))
    assert failure.reason == "ZeroDivisionError: division by zero" and failure.entry == ""
    assert failure.place == "plug_in_mine.py:10 in scaled"
    assert str(failure) == f"{failure.reason}, at {failure.place}"
    assert 'File "plug_in_mine.py", line 6, in act\n    return scaled(level)' in failure.trace


def test_frames_before_the_plug_in_are_cut_and_those_it_calls_are_kept(mine: ModuleType) -> None:
    def ours() -> Any:
        return np.vectorize(lambda _: mine.parse())(np.zeros(1))

    trace = told(ours).trace
    assert trace.index("in parse") < trace.index("decoder.py") and told(ours).place.endswith("in parse")
    assert str(Path(json.__file__).parents[1]) not in trace, "no path of this machine"

    class Breaks(type(defenders.make("none"))):  # type: ignore[misc]
        def reset(self, n_vehicles: int, rng: Any) -> None:
            mine.act(1)

    simulated = told(lambda: play(Breaks(), 5, 2, seed=0))
    assert "defenders/" not in simulated.trace and simulated.place == "plug_in_mine.py:10 in scaled"


def test_an_error_of_ours_has_no_place_and_our_last_frames() -> None:
    failure = told(lambda: defenders.make("prbbi"))
    assert failure.reason.startswith("ValueError: unknown defender 'prbbi'")
    assert failure.place == "" and str(failure) == failure.reason
    assert 'File "defenders/registry.py"' in failure.trace and failure.trace.count("File ") <= 6


def test_a_deep_recursion_and_long_texts_stay_short(mine: ModuleType) -> None:
    failure = told(lambda: mine.deep(600))
    assert "repeated" in failure.trace and len(failure.trace) <= MAX_TRACE + 4

    def long() -> None:
        raise ValueError("word\n" * 10_000)

    reason = told(long).reason
    assert len(reason) == MAX_REASON and reason.endswith("…") and "\n" not in reason


def test_an_exception_without_a_text_or_with_a_terminals_commands_does_no_harm(mine: ModuleType) -> None:
    def hostile() -> None:
        raise mine.Hostile

    assert told(hostile).reason == "Hostile: (its text cannot be made)"

    class Worse(Exception):
        @property
        def __notes__(self) -> Any:
            raise RuntimeError

    def worse() -> None:
        raise Worse

    assert told(worse).reason == "an exception that says nothing of itself"
    assert one_line("a\x1b[31mb\x07\n c") == "a?[31mb? c"


def test_a_cause_in_a_plug_in_is_where_it_happened(mine: ModuleType) -> None:
    def wrapped() -> None:
        try:
            mine.act(1)
        except ZeroDivisionError as error:
            raise RuntimeError("failed in reset") from error

    failure = told(wrapped)
    assert failure.reason == "RuntimeError: failed in reset" and failure.place == "plug_in_mine.py:10 in scaled"


def test_another_process_says_what_happened_there() -> None:
    theirs = Failure("KeyError: 1", "mine.py:3 in inspect", "  File …")

    def remote() -> None:
        raise RemoteError("KeyError: 1", theirs)

    def reset() -> None:
        try:
            remote()
        except RemoteError as error:
            raise RuntimeError("in reset") from error

    def silent() -> None:
        raise RemoteError("its process ended")

    assert told(remote) == theirs
    assert told(reset) == Failure("RuntimeError: in reset", theirs.place, theirs.trace)
    assert told(silent) == Failure("RemoteError: its process ended")


def test_the_first_entry_that_is_noted_is_to_blame(mine: ModuleType) -> None:
    def blame() -> None:
        with blamed("attack a"), blamed("defender mine:Halves"):
            mine.act(1)

    assert told(blame).entry == "defender mine:Halves"
    with pytest.raises(ZeroDivisionError) as caught, blamed("attack a", ValueError):
        mine.act(1)
    assert not hasattr(caught.value, "__notes__")


def test_where_a_generator_waits(mine: ModuleType) -> None:
    asking = mine.asks()
    assert paused_at(asking) == "plug_in_mine.py:21 in asks", "it has not begun"
    next(asking)
    assert paused_at(asking) == "plug_in_mine.py:22 in asks"
    next(asking)
    assert paused_at(asking) == "plug_in_mine.py:27 in more"
    asking.close()
    assert paused_at(asking) == "plug_in_mine.py:21 in asks"
    assert paused_at(iter(())) == "" and paused_at(None) == ""
