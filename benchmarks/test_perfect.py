"""Episodes a second of every defender in the world without scenes: n = 5, k = 2, until convergence or ten frames."""

from __future__ import annotations

import time

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

import defenders
from defenders.perfect import Terms
from defenders.tally import play_many

EPISODES = 200


@pytest.mark.parametrize("name", defenders.names())
def test_episodes(benchmark: BenchmarkFixture, name: str) -> None:
    terms, defender = Terms(n_vehicles=5, n_liars=2, max_frames=10), defenders.make(name)
    start = time.process_time()
    tally = benchmark.pedantic(
        play_many, (defender, terms), {"episodes": EPISODES, "seed": 0}, rounds=5, warmup_rounds=1
    )
    seconds = (time.process_time() - start) / 6  # of CPU time a round
    benchmark.extra_info["episodes a second"] = round(EPISODES / seconds)
    benchmark.extra_info["frames a second"] = round(tally.frames.sum() / seconds)
    print(f"{name}: {EPISODES / seconds:,.0f} episodes and {tally.frames.sum() / seconds:,.0f} frames a second of CPU")
    assert EPISODES / seconds > 20
