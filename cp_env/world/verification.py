"""Lock-step verification: the defenders of all worlds query groups, one forward pass answers, queries are counted.

Convention: a *pair* is (world, group). A defender is given views and nothing else; it is never told the attackers.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

from cp_env.metrics import similarity
from cp_env.types import View
from defenders.checks import check_paid
from defenders.failure import Failure, failure_of, one_line, paused_at
from defenders.protocol import Defender, Inspection, Query, Verdict

Pair = tuple[int, frozenset[int]]
Perceive = Callable[[list[Pair]], list[View]]
Compare = Callable[[Sequence[tuple[View, View]]], np.ndarray]
"""The similarities of many pairs of views, in one go."""


class DefenderError(RuntimeError):
    """A defender raised, asked for nonsense or never stopped asking; its episode is over."""


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame as a defender is shown it (see `defenders.protocol.Frame`)."""

    index: int
    n_vehicles: int
    seen: View  # of everyone present
    _previous: View | None = field(default=None, repr=False)  # the last output, which most defenders compare with
    _older: View | None = field(default=None, repr=False)  # an output before it that the defender still compares with
    _memo: dict[tuple[int, int], tuple[View, View, float]] = field(default_factory=dict, repr=False)
    _asked: set[int] = field(default_factory=set, repr=False)  # the boxes of views that were compared

    @property
    def present(self) -> frozenset[int]:
        """The vehicles that send a map in this frame."""
        return self.seen.group

    def similarity(self, a: View, b: View) -> float:
        """Jaccard similarity of two views, PRBI Eq. (5); the older one is moved by the ego's motion first."""
        key = _key(a, b)
        self._asked.update(key)
        if key not in self._memo:
            self._memo[key] = (a, b, similarity.view_similarity(a, b))
        return self._memo[key][2]

    def agreement(self, a: View, b: View) -> float:
        """Consistency of two views' score maps (PASAC's CCLoss)."""
        return similarity.agreement(a, b)

    def _shown(self) -> Frame:
        """The same for a defender, with twins of the views and a memo of its own: it can change nothing here."""
        previous, older = (one and one.twin() for one in (self._previous, self._older))
        return Frame(self.index, self.n_vehicles, self.seen.twin(), previous, older)


def _key(a: View, b: View) -> tuple[int, int]:
    """The same for both orders and for twins; no other pair's as long as the memo holds both views."""
    one, other = id(a.seen.boxes), id(b.seen.boxes)
    return (one, other) if one < other else (other, one)


def prefetch_similarities(
    verified: Sequence[tuple[Frame, View]], compare: Compare = similarity.view_similarity_many
) -> None:
    """Compare new views with their frame's last output, all in one go: many at once cost little.

    A defender that does not trust the last output compares with an older one, as it did in the frame before: that one,
    too. No defender's results depend on it: similarities asked for later are taken from here instead of computed.
    """
    pairs = [(f, view, old) for f, view in verified for old in (f._previous, f._older) if old is not None]
    values = compare([(view, old) for _, view, old in pairs])
    for (frame, view, old), value in zip(pairs, values.tolist(), strict=True):
        frame._memo[_key(view, old)] = (view, old, value)


@dataclass(frozen=True, eq=False)
class Judgement:
    """The verdict of one world's defender on one frame, and what it cost."""

    verdict: Verdict
    output: View
    groups: tuple[frozenset[int], ...]  # every group asked, in order
    verifications: int  # those of them that count
    error: str | None = None
    failure: Failure | None = None  # what the error says, with its traceback
    reference: View | None = None  # the output of an earlier frame that the defender compared with, the older of two


@dataclass(eq=False)
class _Case:
    """One world's inspection while it runs."""

    world: int
    frame: Frame
    shown: Frame  # what the defender gets of it
    defender: Defender
    views: dict[frozenset[int], View]
    inspection: Inspection | None = None
    query: Query | None = None
    verdict: Verdict | None = None
    groups: list[frozenset[int]] = field(default_factory=list)
    uncounted: list[frozenset[int]] = field(default_factory=list)  # those of them that do not count
    queries: int = 0
    failure: Failure | None = None

    @property
    def error(self) -> str | None:
        if self.failure is None:
            return None
        return f"defender {type(self.defender).__name__} failed in frame {self.frame.index}: {self.failure}"

    @property
    def verifications(self) -> int:
        return len(self.groups) - len(self.uncounted)

    @property
    def everyone(self) -> frozenset[int]:
        return frozenset(range(self.frame.n_vehicles))

    @property
    def present(self) -> frozenset[int]:
        return self.frame.present

    def advance(self) -> None:
        """Send the answers to the pending query; keep the next query or the verdict. A failure ends this case only."""
        try:
            if self.inspection is None:
                self.inspection = self.defender.inspect(self.shown)
                request = next(self.inspection)
            else:
                assert self.query is not None
                request = self.inspection.send([self._answer(group & self.present) for group in self.query.groups])
            self.query = self._checked(request)
        except StopIteration as stop:
            self._conclude(stop.value)
        except Exception as error:  # whatever a plug-in raises must not reach the other worlds
            self._fail(failure_of(error, self.inspection))

    def _answer(self, group: frozenset[int]) -> View:
        """A twin of the group's view: the output is made of ours."""
        return self.shown.seen if group == self.present else self.views[group].twin()

    def _checked(self, request: object) -> Query:
        if not isinstance(request, Query):
            raise ValueError(f"inspect() must yield a Query, not {type(request).__name__}")
        request = Query(request.groups, bool(request.verification))  # ours: a subclass may answer otherwise next time
        self.queries += 1
        if self.queries > self.defender.max_queries:
            raise ValueError(f"more than max_queries = {self.defender.max_queries} queries in one frame")
        for group in request.groups:
            if not group & self.present or not group <= self.everyone:
                raise ValueError(
                    f"a group must hold one or more of the vehicles 0..{self.frame.n_vehicles - 1}, not {sorted(group)}"
                    f"; present in this frame are {sorted(self.present)}"
                )
        self.groups += request.groups
        self.uncounted += () if request.verification else request.groups
        return request

    def _conclude(self, verdict: object) -> None:
        if not isinstance(verdict, Verdict):
            self._refuse(f"inspect() must return a Verdict, not {type(verdict).__name__}")
        elif not verdict.collaborators & self.present or not named(verdict) <= self.everyone:
            self._refuse(
                f"a verdict must fuse at least one of the vehicles 0..{self.frame.n_vehicles - 1} and flag none but "
                f"them, not fuse {sorted(verdict.collaborators)} and flag {sorted(verdict.suspects)}; present are "
                f"{sorted(self.present)}"
            )
        else:
            self._settle(Verdict(verdict.collaborators, verdict.suspects, bool(verdict.converged)))

    def _settle(self, verdict: Verdict) -> None:
        """Take the verdict, if whatever was shown without paying was free: see `defenders.checks.check_paid`."""
        shown = [group & self.present for group in self.uncounted]
        try:
            if shown:
                check_paid(shown, self._counted(), verdict.collaborators & self.present, self.present)
        except ValueError as error:
            self._refuse(str(error))
        else:
            self.verdict, self.query = verdict, None

    def _counted(self) -> list[frozenset[int]]:
        """The groups that were paid for."""
        paid = Counter(self.groups) - Counter(self.uncounted)
        return [group & self.present for group in paid]

    def _refuse(self, reason: str) -> None:
        self._fail(Failure(one_line(reason), paused_at(self.inspection)))

    def _fail(self, failure: Failure) -> None:
        self.failure = failure
        self.verdict, self.query = Verdict(self.everyone), None

    def close(self) -> None:
        if self.inspection is not None:
            with suppress(Exception):  # it has ended, or its failure is known
                self.inspection.close()


def named(verdict: Verdict) -> frozenset[int]:
    """The vehicles that a verdict names."""
    return verdict.collaborators | verdict.suspects


def judge(
    frames: Sequence[Frame],
    defenders: Sequence[Defender],
    perceive: Perceive,
    compare: Compare = similarity.view_similarity_many,
) -> list[Judgement]:
    """Run every defender on its frame, all in lock-step: one forward a round, however many worlds.

    A group asked twice in a frame is computed once but counted twice. The output is free when its group was already
    verified. A defender that fails gets a verdict that fuses everyone, and `error` says why.

    Args:
        frames: the frame of each world.
        defenders: the defender of each world.
        perceive: computes the views of a list of (world, group).
        compare: computes their similarities to the last outputs.

    Returns:
        One judgement a world.
    """
    cases = [
        _Case(world=e, frame=frame, shown=frame._shown(), defender=defender, views={frame.seen.group: frame.seen})
        for e, (frame, defender) in enumerate(zip(frames, defenders, strict=True))
    ]
    _compare([(case, case.frame.seen) for case in cases], compare)
    try:
        running = cases
        while running:
            for case in running:
                case.advance()
            running = [case for case in running if case.query is not None]
            wanted = [(case, group) for case in running if case.query is not None for group in case.query.groups]
            _compute_missing(perceive, compare, wanted)
        outputs = [(case, case.verdict.collaborators) for case in cases if case.verdict is not None]
        _compute_missing(perceive, compare, outputs)
    finally:
        for case in cases:
            case.close()
    return [_judgement(case) for case in cases]


def _compute_missing(perceive: Perceive, compare: Compare, wanted: Sequence[tuple[_Case, frozenset[int]]]) -> None:
    """Compute the views that are not there yet, all worlds in one call."""
    there = [(case, group & case.present) for case, group in wanted]
    missing = {(case.world, group): case for case, group in there if group not in case.views}
    if missing:
        views = perceive(list(missing))
        for (pair, case), view in zip(missing.items(), views, strict=True):
            case.views[pair[1]] = view
        _compare(list(zip(missing.values(), views, strict=True)), compare)


def _compare(verified: Sequence[tuple[_Case, View]], compare: Compare) -> None:
    """Compare new views with the last outputs, and let the defenders know."""
    prefetch_similarities([(case.frame, view) for case, view in verified], compare)
    for case, _ in verified:
        case.shown._memo.update(case.frame._memo)


def _judgement(case: _Case) -> Judgement:
    assert case.verdict is not None
    return Judgement(
        verdict=case.verdict,
        output=case.views[case.verdict.collaborators & case.present],
        groups=tuple(case.groups),
        verifications=case.verifications,
        error=case.error,
        failure=case.failure,
        reference=_reference(case),
    )


def _reference(case: _Case) -> View | None:
    """The earlier output that the defender compared with: a twin of the world's own view, not what a defender holds."""
    for one in (case.frame._older, case.frame._previous):
        if one is not None and id(one.seen.boxes) in case.shown._asked:
            return one.twin()
    return None


def suspicion(defender: Defender, n_vehicles: int) -> np.ndarray:
    """The defender's belief padded to every vehicle: probability that each is malicious; zeros without one."""
    padded = np.zeros(n_vehicles, dtype=np.float32)
    belief = np.asarray(defender.belief(), dtype=np.float32)[:n_vehicles]
    padded[: len(belief)] = belief
    return padded
