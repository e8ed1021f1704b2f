"""PRBI when vehicles are absent, and the second condition of convergence."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from defenders.prbi import Prbi, RobustPrbi
from defenders.prbi.frame_views import FrameViews
from defenders.protocol import Verdict
from tests.defenders.prbi.test_defender import Script, against, benign


def with_absent(defender: Prbi, absent: set[int]) -> Script:
    """A script after its first frame, from which vehicles are absent from now on."""
    script = Script(defender, 5)
    script.frame(benign)
    script.present = frozenset(range(5)) - absent
    return script


def abnormal(attacker: int) -> Callable[[frozenset[int]], float]:
    return lambda group: float(attacker not in group and len(group) < 5)


@pytest.mark.parametrize("defence", [Prbi, RobustPrbi])
@pytest.mark.parametrize("absent", [{1}, {4}, {1, 2}, {3, 4}])
def test_an_absent_vehicle_is_neither_sampled_nor_counted(defence: type[Prbi], absent: set[int]) -> None:
    script = with_absent(defence(), absent)
    for _ in range(2):
        verdict, queries = script.frame(abnormal(attacker=0))
        assert queries
        assert all(group <= script.present for query in queries for group in query.groups)
        assert verdict.collaborators <= script.present
        if script.defender.converged:
            break
    away = sorted(absent)
    assert not script.defender.total[away].any() and not script.defender.normal[away].any()
    assert (script.defender.total[sorted(script.present)] > 0).all()


def test_an_absent_vehicle_keeps_its_counts() -> None:
    script = Script(Prbi(), 5)
    script.frame(benign)
    script.frame(against({3, 0}))
    before = script.defender.total.copy(), script.defender.normal.copy()
    script.present = frozenset({0, 1, 2, 3})
    script.frame(lambda group: float(group.isdisjoint({3, 0}) and len(group) < 4))
    assert (script.defender.total[4], script.defender.normal[4]) == (before[0][4], before[1][4])
    assert (script.defender.total[:4] > before[0][:4]).all()


@pytest.mark.parametrize("convicted", [{0}, {0, 2}, {0, 1, 2, 3}])
def test_if_none_to_be_fused_is_present_the_ego_alone_is_fused(convicted: set[int]) -> None:
    """Even where it is convicted itself; whoever is fused is not flagged."""
    script = Script(Prbi(), 5)
    script.frame(benign)
    script.defender.converged, script.defender.attackers = True, frozenset(convicted)
    script.present = frozenset(convicted)
    verdict, _ = script.frame(benign)
    assert verdict == Verdict({0}, convicted - {0}, converged=True)


@pytest.mark.parametrize("zeros", range(5))
@pytest.mark.parametrize("m", [0.5, 1.0, 1.9, 2.3, 3.0])
def test_the_second_condition_wants_exactly_as_many_vehicles_of_probability_zero(zeros: int, m: float) -> None:
    """Line 27: ⌊m⌋, no more and no fewer, where Eq. (14) holds."""
    defender = Prbi()
    defender.reset(5, np.random.default_rng(0))
    defender.m = m
    defender.history.extend([m] * 4)
    defender.probability = (np.arange(5) >= zeros) * 0.5
    assert defender._is_settled() == (zeros == int(m))


@pytest.mark.parametrize("sizes", [(2, 3), (3, 2), (1, 4), (4, 1)])
def test_divide_and_conquer_begins_with_the_larger_failed_group(sizes: tuple[int, int]) -> None:
    """Line 33, whichever of the two groups that is; a single vehicle is not halved."""
    script = Script(Prbi(), 5)
    script.frame(benign)
    script.seen = (1, frozenset(range(5)))
    script.similarity_of = lambda group: 0.0
    views = FrameViews(script, script.defender.reference, script.defender.epsilon)
    script.index = 1
    failed = [frozenset(script.order[: sizes[0]]), frozenset(script.order[sizes[0] :])]
    search = script.defender._divide_and_conquer(views, failed)
    halved = []
    query = next(search)
    while query is not None:
        halved.append(frozenset().union(*query.groups))
        try:
            query = search.send([(1, group) for group in query.groups])
        except StopIteration:
            query = None
    assert halved[0] == max(failed, key=len)
    assert [group for group in halved if group in failed] == [
        group for group in sorted(failed, key=len, reverse=True) if len(group) > 1
    ]
