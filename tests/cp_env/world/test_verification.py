"""Verification in the world: counts, lock-step, and what a hostile defender cannot do."""

from __future__ import annotations

import itertools
from collections.abc import Iterable

import numpy as np
import pytest

from cp_env.metrics.similarity import view_similarity
from cp_env.types import Detections, View
from cp_env.world.verification import Frame, Pair, judge, prefetch_similarities
from defenders.protocol import Defender, Inspection, Query, Verdict

N = 4


def view_of(group: Iterable[int]) -> View:
    empty = Detections(np.zeros((0, 5)), np.zeros(0))
    return View(frozenset(group), 0, np.zeros(2), empty, empty, np.zeros((2, 2)))


class Scripted(Defender):
    """Sends scripted queries and keeps the views it is given."""

    max_queries = 5

    def __init__(self, rounds: list[object], verdict: object) -> None:
        self.rounds, self.verdict, self.shown = rounds, verdict, []

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None: ...

    def inspect(self, frame: Frame) -> Inspection:
        for query in self.rounds:
            self.shown.append((yield query))
        return self.verdict


class Perceiver:
    """Answers with the group's own view and keeps a log of every forward."""

    def __init__(self) -> None:
        self.calls: list[list[Pair]] = []

    def __call__(self, pairs: list[Pair]) -> list[View]:
        self.calls.append(pairs)
        return [view_of(group) for _, group in pairs]


def run(*defenders: Defender) -> tuple[list, Perceiver]:
    perceive = Perceiver()
    frames = [Frame(3, N, view_of(range(N))) for _ in defenders]
    return judge(frames, defenders, perceive), perceive


def test_one_forward_a_round_for_all_worlds() -> None:
    chatty = Scripted([Query([{0}, {1}]), Query([{2}])], Verdict({2}))
    silent = Scripted([], Verdict(range(N)))
    brief = Scripted([Query([{3}])], Verdict({0, 1}))
    judgements, perceive = run(chatty, silent, brief)
    assert [sorted((e, sorted(g)) for e, g in call) for call in perceive.calls] == [
        [(0, [0]), (0, [1]), (2, [3])],
        [(0, [2])],
        [(2, [0, 1])],
    ]
    assert [j.verifications for j in judgements] == [3, 0, 1]
    assert [sorted(j.output.group) for j in judgements] == [[2], [0, 1, 2, 3], [0, 1]]


def test_answers_come_in_the_order_asked() -> None:
    asker = Scripted([Query([{2, 1}, {0}, {3}])], Verdict({0}))
    run(asker)
    assert [view.group for view in asker.shown[0]] == [{1, 2}, {0}, {3}]


def test_a_group_asked_twice_is_computed_once_and_counted_twice() -> None:
    asker = Scripted([Query([{1}, {1}]), Query([{1}])], Verdict({1}))
    (judgement,), perceive = run(asker)
    assert judgement.verifications == 3
    assert sum(len(call) for call in perceive.calls) == 1


def test_a_reference_that_the_paper_does_not_count_is_free() -> None:
    (judgement,), _ = run(Scripted([Query([{0}], verification=False), Query([{1}])], Verdict({0})))
    assert judgement.verifications == 1
    assert judgement.groups == (frozenset({0}), frozenset({1}))


@pytest.mark.parametrize(
    "free",
    [
        [{0}],
        [range(N)],
        [{1, 2}],  # the output
        [{3}, range(N), {1, 2}, {3}],
    ],
)
def test_what_is_free(free: list[Iterable[int]]) -> None:
    """Everyone's view, the output's group, and one single-vehicle reference, however often each is asked for."""
    (judgement,), _ = run(Scripted([Query([group], verification=False) for group in free], Verdict({1, 2})))
    assert judgement.error is None and judgement.verifications == 0


@pytest.mark.parametrize(
    "unpaid",
    [
        [{0}, {1}],
        [{0, 1}],
        [{1, 2}, {2, 3}, {0}],
        [group for size in (1, 2, 3) for group in itertools.combinations(range(N), size)],
    ],
)
def test_more_than_that_is_an_error_and_no_discount(unpaid: list[Iterable[int]]) -> None:
    for queries in ([Query(unpaid, verification=False)], [Query([group], verification=False) for group in unpaid]):
        (judgement,), _ = run(Scripted(list(queries), Verdict({1, 2})))
        assert judgement.error is not None
        assert "were queried with verification=False" in judgement.error or "max_queries" in judgement.error
        assert judgement.output.group == frozenset(range(N)), "it gets what an undefended ego gets"


def test_a_group_that_is_paid_for_later_was_not_free() -> None:
    queries = [Query([{0, 1}], verification=False), Query([{0, 1}])]
    (judgement,), _ = run(Scripted(list(queries), Verdict({1, 2})))
    assert judgement.error is None and judgement.verifications == 1


class Coy(Query):
    """A query that says it counts when it is asked once, and not when it is asked again."""

    @property
    def verification(self) -> bool:  # type: ignore[override]
        return False

    def __init__(self, groups: Iterable[Iterable[int]]) -> None:
        object.__setattr__(self, "groups", tuple(frozenset(group) for group in groups))


def test_a_query_of_a_class_of_its_own_counts_like_ours() -> None:
    (judgement,), _ = run(Scripted([Coy([{0, 1}, {2, 3}])], Verdict({1, 2})))
    assert judgement.error is not None and "verification=False" in judgement.error


def test_the_view_of_everyone_is_never_computed_again() -> None:
    (judgement,), perceive = run(Scripted([Query([range(N)])], Verdict(range(N))))
    assert perceive.calls == []
    assert judgement.verifications == 1


class Raises(Scripted):
    def inspect(self, frame: Frame) -> Inspection:
        yield Query([{0}])
        raise KeyError("my own bug")


@pytest.mark.parametrize(
    ("hostile", "message"),
    [
        (Raises([], None), r"Raises failed in frame 3: KeyError: 'my own bug'"),
        (Scripted([Query([[]])], None), r"a group must hold"),
        (Scripted([Query([{7}])], None), r"vehicles 0\.\.3, not \[7\]"),
        (Scripted(["verify!"], None), r"must yield a Query, not str"),
        (Scripted([Query([{0}])] * 9, None), r"max_queries = 5"),
        (Scripted([], None), r"must return a Verdict, not NoneType"),
        (Scripted([], Verdict([])), r"must fuse at least one"),
        (Scripted([], Verdict({0}, {9})), r"flag \[9\]"),
    ],
)
def test_a_hostile_defender_ends_its_own_episode_and_no_other(hostile: Defender, message: str) -> None:
    good = Scripted([Query([{1, 2}])], Verdict({1, 2}, {0, 3}))
    judgements, _ = run(hostile, good)
    assert judgements[0].error is not None
    with pytest.raises(AssertionError, match=message):
        raise AssertionError(judgements[0].error)
    assert judgements[0].output.group == frozenset(range(N)), "a failed world falls back on everyone"
    assert judgements[1].error is None
    assert judgements[1].verdict == Verdict({1, 2}, {0, 3})


def test_generators_are_closed_when_perceiving_fails() -> None:
    closed = []

    class Careful(Scripted):
        def inspect(self, frame: Frame) -> Inspection:
            try:
                yield Query([{0}])
            finally:
                closed.append(True)
            return Verdict({0})

    def blind(pairs: list[Pair]) -> list[View]:
        raise OSError("no view")

    with pytest.raises(OSError, match="no view"):
        judge([Frame(0, N, view_of(range(N)))], [Careful([], None)], blind)
    assert closed == [True]


def test_a_frame_shows_nothing_about_perturbations() -> None:
    shown = {name for name in dir(Frame(0, N, view_of({0}))) if not name.startswith("_")}
    assert shown == {"index", "n_vehicles", "present", "seen", "similarity", "agreement"}


def drawn_view(rng: np.random.Generator, frame: int) -> View:
    boxes = np.concatenate([rng.uniform(-30, 30, (6, 2)), rng.uniform(3, 12, (6, 2)), rng.uniform(0, 3, (6, 1))], 1)
    found = Detections(boxes, np.ones(6))
    return View(frozenset({0}), frame, 2.0 * rng.integers(0, 4, 2), found, found, np.zeros((4, 4)))


def test_prefetched_similarities_are_those_computed_when_asked() -> None:
    rng = np.random.default_rng(0)
    previous, seen, alone = (drawn_view(rng, frame) for frame in (0, 1, 0))
    frames = [Frame(1, N, seen, previous), Frame(1, N, previous, previous), Frame(0, N, alone)]
    prefetch_similarities([(frame, frame.seen) for frame in frames])
    assert [len(frame._memo) for frame in frames] == [1, 1, 0]
    for frame in frames[:2]:
        assert frame.similarity(previous, frame.seen) == view_similarity(frame.seen, previous)
        assert len(frame._memo) == 1


class Loyal(Defender):
    """Compares what it sees with one output that it trusts, or with none."""

    def __init__(self, trusted: View | None) -> None:
        self.trusted, self.found = trusted, []

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None: ...

    def inspect(self, frame: Frame) -> Inspection:
        if self.trusted is not None:
            self.found.append(frame.similarity(frame.seen, self.trusted))
        return Verdict(frame.present)
        yield  # a generator


def test_an_output_that_a_defender_keeps_to_is_compared_with_all_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """However old it is: what was compared in the frame before is compared again, in one go and to the same number."""
    rng = np.random.default_rng(0)
    trusted, *seen = (drawn_view(rng, frame) for frame in range(5))
    loyal, previous, older = Loyal(trusted.twin()), trusted, None
    expected = [view_similarity(view, trusted) for view in seen]
    monkeypatch.setattr("cp_env.metrics.similarity.view_similarity", None)  # none is computed by itself
    for view in seen:
        (judgement,) = judge([Frame(view.frame, N, view, previous, older)], [loyal], Perceiver())
        assert judgement.reference is not None
        previous, older = view, judgement.reference
        assert older.seen.boxes is trusted.seen.boxes and older is not trusted
    assert loyal.found == expected


def test_an_output_that_nobody_compares_with_is_not_kept() -> None:
    previous, older, seen = (drawn_view(np.random.default_rng(0), frame) for frame in range(3))
    (judgement,) = judge([Frame(2, N, seen, older, previous)], [Loyal(None)], Perceiver())
    assert judgement.reference is None
