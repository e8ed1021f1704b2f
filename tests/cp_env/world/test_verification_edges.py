"""The referee at its limits: the last query that is allowed, absent vehicles, and belief of another length."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
import pytest

from cp_env.types import View
from cp_env.world.verification import Frame, Judgement, Pair, judge, suspicion
from defenders.protocol import Defender, Query, Verdict
from tests.cp_env.world.test_verification import N, Scripted, view_of


def perceive(pairs: list[Pair]) -> list[View]:
    return [view_of(group) for _, group in pairs]


def judged(defender: Defender, present: Iterable[int] = range(N)) -> Judgement:
    (judgement,) = judge([Frame(3, N, view_of(present))], [defender], perceive)
    return judgement


@pytest.mark.parametrize("limit", [1, 2, 5])
def test_as_many_queries_as_allowed_and_no_more(limit: int) -> None:
    for asked in range(limit + 2):
        scripted = Scripted([Query([{0}])] * asked, Verdict({0}))
        scripted.max_queries = limit
        judgement = judged(scripted)
        assert (judgement.error is None) == (asked <= limit)
        assert judgement.verifications == min(asked, limit)


def test_a_group_or_a_verdict_needs_one_vehicle_that_is_present() -> None:
    present = {0, 2}
    for group in ({0}, {0, 1}, {2, 3}, {0, 1, 2, 3}):
        judgement = judged(Scripted([Query([group])], Verdict(group)), present)
        assert judgement.error is None and judgement.output.group == group & present
    for group in ({1}, {3}, {1, 3}):
        for scripted in (Scripted([Query([group])], Verdict({0})), Scripted([], Verdict(group))):
            judgement = judged(scripted, present)
            assert judgement.error is not None and "present" in judgement.error
            assert "Error: 'frozenset" not in judgement.error and judgement.output.group == present


class Shifty(Query):
    """A query that names one group when it is read first, and more when it is read again."""

    def __init__(self) -> None:
        object.__setattr__(self, "answers", self._answers())
        object.__setattr__(self, "verification", True)

    def _answers(self) -> Iterator[tuple[frozenset[int], ...]]:
        yield (frozenset({0}),)
        while True:
            yield tuple(frozenset({i}) for i in range(N))

    @property
    def groups(self) -> tuple[frozenset[int], ...]:  # type: ignore[override]
        return next(self.answers)  # type: ignore[attr-defined]


def test_what_is_counted_is_what_is_shown_though_a_query_changes() -> None:
    scripted = Scripted([Shifty()], Verdict({0}))
    judgement = judged(scripted)
    assert judgement.error is None
    assert judgement.verifications == len(judgement.groups) == sum(len(views) for views in scripted.shown) == 1


@pytest.mark.parametrize("length", [0, 1, 3, N, N + 2])
def test_belief_is_padded_behind_and_cut_to_the_vehicles(length: int) -> None:
    class Believing(Scripted):
        def belief(self) -> np.ndarray:
            return np.linspace(0.1, 0.9, length)

    expected = np.zeros(N)
    expected[: min(length, N)] = np.linspace(0.1, 0.9, length)[:N]
    np.testing.assert_allclose(suspicion(Believing([], None), N), expected, rtol=1e-6)
