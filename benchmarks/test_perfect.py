"""Episodes a second of every defender in the world without scenes: two attackers, until convergence or ten frames.

The figure is that of the round that took the least CPU time: on a busy machine the others wait for each other's caches.
"""

from __future__ import annotations

import time

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

import defenders
from defenders import Defender
from defenders.simulation.statistics import EpisodeStats, play_many
from defenders.simulation.world import Scenario

EPISODES = {"bayes": 50}  # a round, where not 200
LEAST = {"bayes": 50}  # episodes a second, where not 200: far below what any machine of today does
BEHIND_PRBI = 16  # times slower than PRBI that `bayes` may be with five vehicles; seven is usual


@pytest.mark.parametrize(
    ("name", "n"), [(name, n) for n in (5, 64) for name in defenders.names() if (name, n) != ("bayes", 64)]
)
def test_episodes(benchmark: BenchmarkFixture, name: str, n: int) -> None:
    scenario, defender = Scenario(n_vehicles=n, n_attackers=2, max_frames=10), defenders.make(name)
    episodes, seconds = EPISODES.get(name, 200), []

    def play() -> EpisodeStats:
        start = time.process_time()
        stats = play_many(defender, scenario, episodes=episodes, seed=0)
        seconds.append(time.process_time() - start)
        return stats

    stats = benchmark.pedantic(play, rounds=20, warmup_rounds=1)
    speed, frames = episodes / min(seconds), stats.frames.sum() / min(seconds)
    benchmark.extra_info["episodes a second"], benchmark.extra_info["frames a second"] = round(speed), round(frames)
    print(f"{name}, n = {n}: {speed:,.0f} episodes and {frames:,.0f} frames a second of CPU")
    assert speed > LEAST.get(name, 200 if n == 5 else 20)


def test_bayes_against_prbi(benchmark: BenchmarkFixture) -> None:
    """Both in turn, so that what else the machine does slows both; new episodes in every round."""
    scenario, players = Scenario(n_vehicles=5, n_attackers=2, max_frames=10), ("bayes", "prbi")
    made: dict[str, Defender] = {name: defenders.make(name) for name in players}
    seconds: dict[str, list[float]] = {name: [] for name in players}

    def both() -> None:
        for name in players:
            start = time.process_time()
            play_many(made[name], scenario, episodes=50, seed=len(seconds[name]))
            seconds[name].append(time.process_time() - start)

    benchmark.pedantic(both, rounds=20, warmup_rounds=1)
    bayes, prbi = (50 / min(seconds[name]) for name in players)
    benchmark.extra_info["prbi's episodes for one of bayes"] = round(prbi / bayes, 2)
    print(f"n = 5: bayes {bayes:,.0f} and prbi {prbi:,.0f} episodes a second of CPU: a ratio of {prbi / bayes:.2f}")
    assert bayes * BEHIND_PRBI > prbi
