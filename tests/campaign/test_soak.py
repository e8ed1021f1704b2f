"""The small cut: seconds of toy worlds; and growth of every kind is seen."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import pytest

from tests.campaign.case import Fault
from tests.campaign.soak import HANDLES, Args, Sample, judged, soak

pytestmark = pytest.mark.skipif(not Path("/proc/self/statm").is_file(), reason="reads /proc")

FLAT = [Sample(float(t), 16 * t, 80 * t, 500.0 + t % 3, 20, 4, 0, 1) for t in range(1, 101)]


def test_worlds_are_reset_and_sampled() -> None:
    samples = list(itertools.islice(soak(Args(minutes=60, worlds=2, frames=2, scenes="toy", samples=10**9)), 3))
    assert len(samples) == 3
    turns = [(sample.resets - 4) // 4 for sample in samples]  # each resets two worlds of two environments
    assert turns == list(range(turns[0], turns[0] + 3))
    assert [sample.frames for sample in samples] == [turn * 2 * 2 * 2 for turn in turns]
    assert all(sample.memory_mb > 50 and sample.files > 2 and sample.threads > 0 for sample in samples)
    assert len({(sample.files, sample.children) for sample in samples}) == 1


def test_what_is_flat_holds() -> None:
    found = judged(FLAT)
    assert found["resets"] == 1600 and abs(found["slope_mb_per_hour"]) < 100 and found["memory_mb"] == 501


def test_growth_in_the_first_half_is_warming_up() -> None:
    judged([replace(s, memory_mb=min(s.seconds, 50) * 10, files=min(int(s.seconds), 50)) for s in FLAT])


def test_memory_that_grows_is_a_fault() -> None:
    with pytest.raises(Fault, match=r"memory grew from .* MB an hour"):
        judged([replace(s, memory_mb=500 + s.seconds) for s in FLAT])


@pytest.mark.parametrize("name", HANDLES)
def test_handles_that_grow_are_a_fault(name: str) -> None:
    with pytest.raises(Fault, match=f"{name} grew from"):
        judged([replace(s, **{name: int(s.seconds) // 20}) for s in FLAT])
