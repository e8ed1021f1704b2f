"""What verdicts on groups prove, by hand and as a law."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from defenders.prbi.group_testing import Proof

A, B, C, D = range(4)


def group(*members: int) -> frozenset[int]:
    return frozenset(members)


def test_by_hand() -> None:
    proof = Proof(4)
    assert proof.open == group(A, B, C, D) and not proof.convicted
    assert not proof.learn({group(A, B): False, group(C, D): False})  # a liar in each: nobody is settled
    assert proof.learn({group(A, C): True})
    assert (proof.cleared, proof.convicted, proof.open) == (group(A, C), group(B, D), group())


def test_the_last_open_vehicle_of_an_abnormal_frame_lies() -> None:
    proof = Proof(4)
    proof.learn({group(A, B, C, D): False, group(A, B): True, group(C): True})
    assert proof.convicted == group(D)


def test_contradiction_leaves_the_last_frame() -> None:
    """A and B passed together and then fail together: nobody else can have spoilt that view, so the pass is void."""
    proof = Proof(4)
    proof.learn({group(A, B): True, group(C, D): False})
    assert not proof.learn({group(A, B): False, group(C): True})
    assert (proof.cleared, proof.convicted, proof.open) == (group(C), group(), group(A, B, D))


def test_a_frame_that_contradicts_itself_proves_nothing() -> None:
    proof = Proof(4)
    proof.learn({group(A, B, C, D): False, group(A, B): True, group(C, D): True})
    assert proof.open == proof.everyone


def test_somebody_is_honest() -> None:
    proof = Proof(2)
    proof.learn({group(0): False, group(1): False})
    assert proof.open == proof.everyone


@given(st.data(), st.integers(2, 12))
def test_right_verdicts_prove_the_truth(data: st.DataObject, n: int) -> None:
    vehicles = st.integers(0, n - 1)
    liars = data.draw(st.frozensets(vehicles, min_size=1, max_size=n - 1))
    proof = Proof(n)
    for groups in data.draw(st.lists(st.lists(st.frozensets(vehicles, min_size=1), max_size=3), max_size=8)):
        settled = proof.cleared | proof.convicted
        learned = proof.learn({some: some.isdisjoint(liars) for some in groups})
        assert settled <= proof.cleared | proof.convicted  # knowledge only grows
        assert learned == (settled != proof.cleared | proof.convicted)
        assert proof.convicted <= liars
        assert proof.cleared.isdisjoint(liars)
        assert proof.open == proof.everyone - proof.cleared - proof.convicted
    proof.learn({frozenset({i}): i not in liars for i in range(n)})
    assert (proof.convicted, proof.open) == (liars, frozenset())
