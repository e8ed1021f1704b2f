"""Real numbers from whatever is given as an action, within bounds of memory."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from cp_env.envs.actions.base import LARGEST, real_numbers
from tests.campaign.values import STRANGE, Raising


def test_strange_values_are_numbers_or_refused_in_a_sentence() -> None:
    taken, refusals = [], []
    for make in STRANGE:
        try:
            taken.append(real_numbers(make(), "it"))
        except ValueError as error:
            refusals.append(str(error))
    assert taken and all(numbers.dtype == np.float32 for numbers in taken)
    assert len(refusals) > 20 and all(said.startswith("it must hold ") and len(said) < 400 for said in refusals)


@pytest.mark.parametrize(
    "action",
    [range(10**9), [range(10**9), range(10**9)], np.broadcast_to(np.float32(0), (10**6, 10**6))],
    ids=["range", "ranges", "broadcast"],
)
def test_what_holds_too_many_numbers_takes_no_memory(action: object) -> None:
    tracemalloc.start()
    with pytest.raises(ValueError, match=f"must hold at most {LARGEST} numbers"):
        real_numbers(action)
    assert tracemalloc.get_traced_memory()[1] < 1 << 20
    tracemalloc.stop()


def test_whatever_an_object_raises_is_no_action() -> None:
    with pytest.raises(ValueError, match="must hold real numbers and no graph: 'it has no array'"):
        real_numbers(Raising())
