"""The process of a sealed defender: `python -m defenders.sealed.child` reads requests and writes answers, line by line.

One process holds the defenders of all worlds of a run. While a defender's `inspect` runs, a similarity that it asks for
is a question to the parent on the same pipe, answered before anything else is asked.
"""

from __future__ import annotations

import copy
import io
import json
import os
import sys
import threading
import time
import weakref
from dataclasses import dataclass, field
from typing import Any, TextIO

import numpy as np

import defenders
from defenders.failure import failure_of
from defenders.protocol import Defender, EgoFusion, Informed, Inspection, Query, Verdict

WATCH = 0.5
"""Seconds after which it is asked again whether the parent lives."""


class Handle:
    """A view as a sealed defender holds it: nothing but itself."""

    def __init__(self, number: int) -> None:
        self.number = number

    def __deepcopy__(self, memo: dict[int, Any]) -> Handle:
        return self


@dataclass(frozen=True)
class SealedFrame:
    """One frame as a defender sees it (see `defenders.protocol.Frame`)."""

    index: int
    n_vehicles: int
    present: frozenset[int]
    seen: Handle
    _server: Server = field(repr=False)

    def similarity(self, a: Handle, b: Handle) -> float:
        """The parent's answer."""
        return self._server.ask("similarity", a, b)

    def agreement(self, a: Handle, b: Handle) -> float:
        """The parent's answer."""
        return self._server.ask("agreement", a, b)


class Server:
    """Answers requests until the pipe is closed."""

    def __init__(self, requests: TextIO, answers: TextIO) -> None:
        self._in, self._out = requests, answers
        self._defenders: dict[int, Defender] = {}
        self._rngs: dict[int, np.random.Generator] = {}
        self._inspections: dict[int, Inspection] = {}
        self._handles: weakref.WeakValueDictionary[int, Handle] = weakref.WeakValueDictionary()

    def serve(self) -> None:
        """Read requests; an error of the defender's is an answer like any other."""
        for line in self._in:
            request = json.loads(line)
            try:
                answer = getattr(self, f"_do_{request.pop('op')}")(**request)
            except Exception as error:  # whatever a plug-in raises is reported to the parent
                failure = failure_of(error)
                answer = {"error": failure.reason, "place": failure.place, "trace": failure.trace}
            self._write(answer)

    def ask(self, what: str, a: Handle, b: Handle) -> float:
        """A number about two views, from the parent."""
        if not isinstance(a, Handle) or not isinstance(b, Handle):
            raise TypeError(f"{what} compares two views that were handed out in a frame")
        self._write({"ask": [what, a.number, b.number]})
        return float(json.loads(self._in.readline())["value"])

    def _write(self, answer: dict[str, Any]) -> None:
        self._out.write(json.dumps(answer) + "\n")
        self._out.flush()

    def _handle(self, number: int) -> Handle:
        if number not in self._handles:
            handle = Handle(number)
            self._handles[number] = handle
            return handle
        return self._handles[number]

    # -- requests ------------------------------------------------------------------------------------------------

    def _do_make(self, number: int, spec: str, path: list[str]) -> dict[str, Any]:
        sys.path[:0] = [entry for entry in path if entry not in sys.path]
        made = defenders.make(spec)
        self._defenders[number] = made
        return {"informed": isinstance(made, Informed), "max_queries": int(made.max_queries)}

    def _do_copy(self, number: int, new: int, rng: dict[str, Any] | None) -> dict[str, Any]:
        memo: dict[int, Any] = {}
        own = self._rngs.get(number)
        if rng is not None and own is not None:
            memo[id(own)] = generator_of(rng)
        self._defenders[new] = copy.deepcopy(self._defenders[number], memo)
        if own is not None:
            self._rngs[new] = memo.get(id(own), own)
        return {}

    def _do_drop(self, numbers: list[int]) -> dict[str, Any]:
        for number in numbers:
            for table in (self._defenders, self._rngs, self._inspections):
                table.pop(number, None)
        return {}

    def _do_configure(self, number: int, fusion: str, detector: str | None) -> dict[str, Any]:
        self._defenders[number].configure(fusion=EgoFusion(fusion, detector))
        return {}

    def _do_reveal(self, number: int, attackers: list[int]) -> dict[str, Any]:
        defender = self._defenders[number]
        assert isinstance(defender, Informed)
        defender.reveal_attackers(frozenset(attackers))
        return {}

    def _do_reset(self, number: int, n_vehicles: int, rng: dict[str, Any]) -> dict[str, Any]:
        self._rngs[number] = generator_of(rng)
        self._defenders[number].reset(n_vehicles, self._rngs[number])
        return {}

    def _do_inspect(self, number: int, index: int, n_vehicles: int, present: list[int], seen: int) -> dict[str, Any]:
        frame = SealedFrame(index, n_vehicles, frozenset(present), self._handle(seen), self)
        self._inspections[number] = self._defenders[number].inspect(frame)
        return self._advance(number, None)

    def _do_send(self, number: int, views: list[int]) -> dict[str, Any]:
        return self._advance(number, [self._handle(view) for view in views])

    def _do_close(self, number: int) -> dict[str, Any]:
        inspection = self._inspections.pop(number, None)
        if inspection is not None:
            inspection.close()
        return {}

    def _do_belief(self, number: int) -> dict[str, Any]:
        return {"belief": np.asarray(self._defenders[number].belief(), dtype=float).ravel().tolist()}

    def _advance(self, number: int, views: list[Handle] | None) -> dict[str, Any]:
        try:
            query = self._inspections[number].send(views)  # type: ignore[arg-type]  # None begins it
        except StopIteration as stop:
            del self._inspections[number]
            return self._verdict(stop.value)
        if not isinstance(query, Query):
            raise ValueError(f"inspect() must yield a Query, not {type(query).__name__}")
        return {"query": [sorted(group) for group in query.groups], "verification": bool(query.verification)}

    def _verdict(self, verdict: object) -> dict[str, Any]:
        if not isinstance(verdict, Verdict):
            raise ValueError(f"inspect() must return a Verdict, not {type(verdict).__name__}")
        return {
            "verdict": [sorted(verdict.collaborators), sorted(verdict.suspects), bool(verdict.converged)],
            "live": list(self._handles.keys()),
        }


def generator_of(rng: dict[str, Any]) -> np.random.Generator:
    """The generator that the parent described: its seed sequence, for spawning, and its state."""
    sequence = np.random.SeedSequence(rng["entropy"], spawn_key=rng["spawn_key"], n_children_spawned=rng["spawned"])
    generator = np.random.default_rng(sequence)
    generator.bit_generator.state = rng["state"]
    return generator


def end_with_parent() -> None:
    """Let this process end within a second of the one that started it, even if a defender is at work for ever."""
    parent = os.getppid()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH)
        os._exit(1)

    threading.Thread(target=watch, name="parent's end", daemon=True).start()


def main() -> None:
    """Serve on standard input and output; what a plug-in prints goes to standard error."""
    end_with_parent()
    answers = io.TextIOWrapper(os.fdopen(os.dup(1), "wb"), encoding="utf-8")
    os.dup2(2, 1)
    Server(sys.stdin, answers).serve()


if __name__ == "__main__":
    main()
