"""Different seeds are different streams: a spawned sequence is none of another entropy."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from cp_env.world.streams import Stream

words = st.lists(st.integers(0, 2), max_size=3).map(tuple)


@given(st.lists(st.tuples(words.filter(bool), words), min_size=2, max_size=2, unique=True))
def test_sequences_that_differ_begin_streams_that_differ(pair: list[tuple[tuple[int, ...], tuple[int, ...]]]) -> None:
    first, second = (
        Stream.of(np.random.SeedSequence(list(entropy), spawn_key=spawn_key)) for entropy, spawn_key in pair
    )
    assert first != second
