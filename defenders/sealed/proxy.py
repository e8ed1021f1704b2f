"""The world's side of a sealed defender: it looks like a defender, and asks the process that holds the real one."""

from __future__ import annotations

import json
import math
import sys
import time
import weakref
from pathlib import Path
from typing import Any

import numpy as np

from defenders.failure import MAX_TRACE, Failure, RemoteError, one_line, plain
from defenders.protocol import Defender, EgoFusion, Frame, Informed, Inspection, Query, Verdict, View
from defenders.sealed.pipe import Pipe, PipeError

PATIENCE = 60.0
"""Seconds that are waited for an answer; then the defender has failed, and its process is ended. Our choice."""


class SealedError(RemoteError):
    """The process of a sealed defender failed, or answered what is no answer."""


class Process:
    """The process that holds the defenders of one run. It ends when its last proxy is gone, or this process is.

    Args:
        patience: seconds that are waited for each answer, the questions on the way to it included.
    """

    def __init__(self, patience: float = PATIENCE) -> None:
        self.patience, self._until = patience, 0.0
        self._pipe = Pipe([sys.executable, "-m", "defenders.sealed.child"])
        self._numbers = 0
        self._gone: list[int] = []  # proxies that were collected; told at the next request
        self._views: dict[int, View] = {}
        self._handles: dict[int, int] = {}  # from a view's id to its handle, as long as the view is held
        self._issued = 0

    def number(self) -> int:
        """A number for one more defender in the process."""
        self._numbers += 1
        return self._numbers

    def forget(self, number: int) -> None:
        """Let the process drop a defender. Called while garbage is collected, so nothing is sent now."""
        self._gone.append(number)

    def request(self, op: str, **fields: Any) -> dict[str, Any]:
        """Ask, and wait for the answer; an answer may be a question of the child's."""
        self._until = time.monotonic() + self.patience
        if self._gone:
            gone, self._gone = self._gone, []
            self._exchange({"op": "drop", "numbers": gone})
        return self._exchange({"op": op, **fields})

    def reply(self, value: float) -> dict[str, Any]:
        """Answer the child's question, and wait for what follows."""
        return self._exchange({"value": value})

    def handle(self, view: View) -> int:
        """The handle of a view; the same for the same view."""
        if id(view) not in self._handles:
            self._issued += 1
            self._handles[id(view)], self._views[self._issued] = self._issued, view
        return self._handles[id(view)]

    def view(self, handle: object) -> View:
        """The view of a handle. SealedError if it was never handed out, or dropped by the child."""
        if not isinstance(handle, int) or handle not in self._views:
            raise SealedError(f"asked about a view that it does not hold: {handle!r:.40}")
        return self._views[handle]

    def keep(self, live: object) -> None:
        """Hold only the views whose handles the child still holds."""
        kept = set(live) if isinstance(live, list) else set()
        self._views = {handle: view for handle, view in self._views.items() if handle in kept}
        self._handles = {id(view): handle for handle, view in self._views.items()}

    def _exchange(self, message: dict[str, Any]) -> dict[str, Any]:
        try:
            answer = json.loads(self._pipe.exchange(json.dumps(message), self._until))
        except PipeError as error:
            reason = f"{error} (it has {self.patience:g} s for an answer)"
            raise SealedError(reason, Failure(f"SealedError: {reason}", killed=error.killed)) from error
        except (ValueError, RecursionError) as error:
            raise SealedError(f"its process does not answer ({error})") from error
        if not isinstance(answer, dict):
            raise SealedError(f"answered what is no answer: {answer!r:.80}")
        if "error" in answer:
            failure = received(answer)
            raise SealedError(failure.reason, failure)
        return answer


class SealedDefender(Defender):
    """A defender whose code runs in another process: see `seal`."""

    def __init__(self, name: str, process: Process, number: int, max_queries: int) -> None:
        self.name, self.max_queries = name, max_queries
        self._process, self._number = process, number
        self._rng: np.random.Generator | None = None
        weakref.finalize(self, process.forget, number)

    def __deepcopy__(self, memo: dict[int, Any]) -> SealedDefender:
        """Another defender in the same process, as it is now; with another generator, if the memo says so."""
        new = self._process.number()
        rng = memo.get(id(self._rng))
        self._process.request("copy", number=self._number, new=new, rng=None if rng is None else described(rng))
        twin = type(self)(self.name, self._process, new, self.max_queries)
        twin._rng = rng or self._rng
        return twin

    def __reduce__(self) -> Any:
        raise TypeError("a sealed defender cannot be pickled: its state is in another process")

    def configure(self, *, fusion: str) -> None:
        detector = fusion.detector if isinstance(fusion, EgoFusion) else None
        self._process.request("configure", number=self._number, fusion=fusion, detector=detector)

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        """Begin an episode; the child gets a generator in the same state."""
        self._rng = rng
        self._process.request("reset", number=self._number, n_vehicles=n_vehicles, rng=described(rng))

    def inspect(self, frame: Frame) -> Inspection:
        process, number = self._process, self._number
        asked = {
            "index": frame.index,
            "n_vehicles": frame.n_vehicles,
            "present": sorted(frame.present),
            "seen": process.handle(frame.seen),
        }
        answer = process.request("inspect", number=number, **asked)
        done = False
        try:
            while "verdict" not in answer:
                if "ask" in answer:
                    answer = process.reply(_compared(process, frame, answer["ask"]))
                else:
                    views = yield _query(answer)
                    answer = process.request("send", number=number, views=[process.handle(view) for view in views])
            done = True
        except SealedError:
            done = True
            raise
        finally:
            if not done:
                process.request("close", number=number)
        process.keep(answer.get("live"))
        return _verdict(answer["verdict"])

    def belief(self) -> np.ndarray:
        answer = self._process.request("belief", number=self._number)
        return np.asarray(answer.get("belief", []), dtype=float)


class SealedInformedDefender(SealedDefender, Informed):
    """A sealed bound: it is shown the ground truth."""

    def reveal_attackers(self, attackers: frozenset[int]) -> None:
        self._process.request("reveal", number=self._number, attackers=sorted(attackers))


def seal(spec: str, *, patience: float = PATIENCE) -> SealedDefender:
    """A defender in a fresh process of its own.

    Args:
        spec: a name or place with options, as `defenders.make` takes it. Objects cannot be sealed.
        patience: seconds that are waited for each answer. After that the defender has failed, which ends its episode
            with an error that says so, and its process is ended.

    Returns:
        A defender that a world may copy; the copies live in the same process.

    Raises:
        ValueError: what `defenders.make` raises there.
    """
    process = Process(patience)
    number = process.number()
    try:
        made = process.request("make", number=number, spec=spec, path=[entry or str(Path.cwd()) for entry in sys.path])
    except SealedError as error:
        raise ValueError(str(error).removeprefix("ValueError: ")) from error
    cls = SealedInformedDefender if made.get("informed") is True else SealedDefender
    return cls(spec, process, number, int(made["max_queries"]))


def received(answer: dict[str, Any]) -> Failure:
    """The failure that an answer reports, in plain characters and within bounds."""
    place, trace = (str(answer.get(name, ""))[:MAX_TRACE] for name in ("place", "trace"))
    return Failure(one_line(str(answer["error"])), one_line(place), plain(trace))


def described(rng: np.random.Generator) -> dict[str, Any]:
    """A generator as plain numbers: its seed sequence, for spawning, and its state."""
    sequence = rng.bit_generator.seed_seq
    assert isinstance(sequence, np.random.SeedSequence)
    state = json.loads(json.dumps(rng.bit_generator.state, default=int))
    return {
        "entropy": sequence.entropy if isinstance(sequence.entropy, int) else list(sequence.entropy or ()),
        "spawn_key": list(sequence.spawn_key),
        "spawned": sequence.n_children_spawned,
        "state": state,
    }


def _compared(process: Process, frame: Frame, asked: object) -> float:
    if not (isinstance(asked, list) and len(asked) == 3 and asked[0] in ("similarity", "agreement")):
        raise SealedError(f"asked what is no question: {asked!r:.80}")
    compare = frame.similarity if asked[0] == "similarity" else frame.agreement
    value = float(compare(process.view(asked[1]), process.view(asked[2])))
    if not math.isfinite(value):
        raise SealedError("a similarity that is no number")
    return value


def _query(answer: dict[str, Any]) -> Query:
    try:
        return Query([[int(i) for i in group] for group in answer["query"]], answer["verification"] is not False)
    except (KeyError, TypeError, ValueError) as error:
        raise SealedError(f"asked what is no query: {answer!r:.80}") from error


def _verdict(answer: object) -> Verdict:
    if not isinstance(answer, list) or len(answer) != 3:
        raise SealedError(f"gave what is no verdict: {answer!r:.80}")
    collaborators, suspects, converged = answer
    try:
        return Verdict([int(i) for i in collaborators], [int(i) for i in suspects], converged is True)
    except (TypeError, ValueError) as error:
        raise SealedError(f"gave what is no verdict: {answer!r:.80}") from error
