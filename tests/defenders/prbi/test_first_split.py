"""Random divisions of the first abnormal frame: partitions, with the sizes that their names promise."""

from __future__ import annotations

from collections import Counter
from math import comb

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from defenders.prbi.first_split import even_split, independent_split


@pytest.mark.parametrize("split", [even_split, independent_split])
@given(st.integers(1, 12), st.integers(0, 2**32))
def test_both_groups_make_up_the_fleet(split: object, n: int, seed: int) -> None:
    first, second = split(range(n), np.random.default_rng(seed))  # type: ignore[operator]
    assert sorted(first + second) == list(range(n))


@given(st.integers(2, 12), st.integers(0, 2**32))
def test_an_even_split_has_no_empty_group(n: int, seed: int) -> None:
    assert all(even_split(range(n), np.random.default_rng(seed)))


def test_a_single_vehicle_is_not_divided() -> None:
    assert even_split([3], np.random.default_rng(0)) == ([3], [])


def test_sizes_of_an_even_split_are_equally_likely() -> None:
    rng = np.random.default_rng(0)
    sizes = Counter(len(even_split(range(5), rng)[0]) for _ in range(4000))
    assert sorted(sizes) == [1, 2, 3, 4]
    assert all(count == pytest.approx(1000, abs=4 * 1000**0.5) for count in sizes.values())


def test_sizes_of_a_independent_split_are_binomial() -> None:
    rng, episodes = np.random.default_rng(0), 4000
    sizes = Counter(len(independent_split(range(4), rng)[0]) for _ in range(episodes))
    for size in range(5):
        expected = episodes * comb(4, size) / 16
        assert sizes[size] == pytest.approx(expected, abs=4 * expected**0.5)


@pytest.mark.parametrize("split", [even_split, independent_split])
def test_every_vehicle_is_as_likely_as_any_other_to_lead(split: object) -> None:
    rng = np.random.default_rng(1)
    leaders = Counter(first[0] for first, _ in (split(range(5), rng) for _ in range(4000)) if first)  # type: ignore[operator]
    total = sum(leaders.values())
    assert all(count == pytest.approx(total / 5, abs=4 * (total / 5) ** 0.5) for count in leaders.values())
