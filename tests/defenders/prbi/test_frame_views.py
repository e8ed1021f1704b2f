"""The views of one frame: what is asked for once, what is free, and which of them are consistent."""

from __future__ import annotations

from typing import Any

from defenders.prbi.frame_views import FrameViews, union
from defenders.protocol import Query

ALL, PAIR, OTHERS, EGO = frozenset(range(4)), frozenset({0, 1}), frozenset({2, 3}), frozenset({0})


class Scene:
    """A frame in which a view is its group, and similarity the share of vehicles that two groups have in common."""

    index, n_vehicles, compared = 1, 4, 0
    present = seen = ALL

    def __init__(self, disjoint: float) -> None:
        self.disjoint = disjoint  # similarity of groups that have nobody in common

    def similarity(self, a: Any, b: Any) -> float:
        self.compared += 1
        return len(a & b) / len(a | b) or self.disjoint

    def agreement(self, a: Any, b: Any) -> float:
        raise NotImplementedError


def answered(asking: Any) -> list[Query]:
    """Every query, each group answered with itself."""
    queries: list[Query] = []
    try:
        query = next(asking)
        while True:
            queries.append(query)
            query = asking.send(list(query.groups))
    except StopIteration:
        return queries


def started(epsilon: float = 0.5, disjoint: float = 0.0) -> tuple[FrameViews, Scene]:
    """The views of a frame whose reference is everyone's view."""
    scene = Scene(disjoint)
    return FrameViews(scene, ALL, lambda group: epsilon), scene


def test_the_view_of_all_present_is_free() -> None:
    views, _ = started()
    assert answered(views.verify([ALL])) == [] and answered(views.perceive(ALL)) == []
    assert views.verdicts() == {ALL: True}


def test_a_group_is_paid_for_once_and_in_one_query_with_the_others() -> None:
    views, _ = started()
    assert answered(views.verify([PAIR, ALL, OTHERS])) == [Query([PAIR, OTHERS], True)]
    assert answered(views.verify([PAIR, EGO])) == [Query([EGO], True)]
    assert set(views.views) == {ALL, PAIR, OTHERS, EGO}


def test_what_is_perceived_for_the_output_is_paid_for_when_it_is_rejected() -> None:
    views, _ = started()
    (perceived,) = answered(views.perceive(PAIR))
    assert not perceived.verification and answered(views.perceive(PAIR)) == []
    assert answered(views.reject(PAIR)) == [Query([PAIR], True)]


def test_a_similarity_of_exactly_epsilon_passes() -> None:
    views, _ = started(epsilon=0.5)
    answered(views.verify([PAIR, EGO]))
    assert views.verdicts() == {ALL: True, PAIR: True, EGO: False}  # 1, 1/2 and 1/4 of the reference


def test_a_view_is_compared_with_the_reference_once() -> None:
    views, scene = started()
    assert views.similarity(ALL) == views.similarity(ALL) == 1 and views.is_consistent(ALL)
    assert scene.compared == 1


def test_support_comes_from_groups_that_share_no_vehicle() -> None:
    views, _ = started(disjoint=0.25)
    answered(views.verify([PAIR, OTHERS, EGO]))
    assert views.support(OTHERS) == 0.5  # PAIR and EGO
    assert views.support(PAIR) == views.support(EGO) == 0.25  # OTHERS
    assert views.support(ALL) == 0.0, "every group shares a vehicle with all"


def test_a_union_holds_everyone_once() -> None:
    assert union([PAIR, frozenset({1, 3})]) == {0, 1, 3} and union([]) == frozenset()
