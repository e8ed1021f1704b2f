"""Group testing: by hand and as a law."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from defenders.prbi.group_testing import GroupTest

A, B, C, D = range(4)


def group(*members: int) -> frozenset[int]:
    return frozenset(members)


def test_by_hand() -> None:
    group_test = GroupTest(4)
    assert group_test.open == group(A, B, C, D) and not group_test.convicted
    assert not group_test.learn({group(A, B): False, group(C, D): False})  # an attacker in each: nobody is settled
    assert group_test.learn({group(A, C): True})
    assert (group_test.cleared, group_test.convicted, group_test.open) == (group(A, C), group(B, D), group())


def test_the_last_open_vehicle_of_an_abnormal_frame_is_convicted() -> None:
    group_test = GroupTest(4)
    group_test.learn({group(A, B, C, D): False, group(A, B): True, group(C): True})
    assert group_test.convicted == group(D)


def test_contradiction_leaves_the_last_frame() -> None:
    """A and B passed together and then fail together: no other vehicle can have caused that, so the pass is void."""
    group_test = GroupTest(4)
    group_test.learn({group(A, B): True, group(C, D): False})
    assert not group_test.learn({group(A, B): False, group(C): True})
    assert (group_test.cleared, group_test.convicted, group_test.open) == (group(C), group(), group(A, B, D))


def test_a_frame_that_contradicts_itself_proves_nothing() -> None:
    group_test = GroupTest(4)
    group_test.learn({group(A, B, C, D): False, group(A, B): True, group(C, D): True})
    assert group_test.open == group_test.everyone


def test_somebody_is_benign() -> None:
    group_test = GroupTest(2)
    group_test.learn({group(0): False, group(1): False})
    assert group_test.open == group_test.everyone


@given(st.data(), st.integers(2, 12))
def test_right_verdicts_prove_the_truth(data: st.DataObject, n: int) -> None:
    vehicles = st.integers(0, n - 1)
    attackers = data.draw(st.frozensets(vehicles, min_size=1, max_size=n - 1))
    group_test = GroupTest(n)
    for groups in data.draw(st.lists(st.lists(st.frozensets(vehicles, min_size=1), max_size=3), max_size=8)):
        settled = group_test.cleared | group_test.convicted
        learned = group_test.learn({some: some.isdisjoint(attackers) for some in groups})
        assert settled <= group_test.cleared | group_test.convicted  # knowledge only grows
        assert learned == (settled != group_test.cleared | group_test.convicted)
        assert group_test.convicted <= attackers
        assert group_test.cleared.isdisjoint(attackers)
        assert group_test.open == group_test.everyone - group_test.cleared - group_test.convicted
    group_test.learn({frozenset({i}): i not in attackers for i in range(n)})
    assert (group_test.convicted, group_test.open) == (attackers, frozenset())
