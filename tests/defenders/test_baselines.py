"""The three bounds, the registry, and thresholds by group size."""

from __future__ import annotations

import numpy as np
import pytest

import defenders
from defenders import EgoOnly, NoDefence, Oracle
from defenders.simulation.world import SimulatedWorld, play


def test_none_fuses_everyone_and_pays_nothing() -> None:
    episode = play(NoDefence(), 5, 2, seed=0, max_frames=3)
    for result in episode.results:
        assert result.verdict == defenders.Verdict(range(5)) and result.verifications == 0


def test_ego_only_trusts_the_ego() -> None:
    episode = play(EgoOnly(), 5, 2, seed=0, max_frames=3)
    assert all(result.verdict == defenders.Verdict({0}) for result in episode.results)


def test_oracle_excludes_exactly_the_attackers_at_once() -> None:
    for seed in range(10):
        episode = play(Oracle(), 5, 3, seed)
        assert len(episode.results) == 1 and episode.verifications == [0]
        assert episode.suspects == episode.attackers


def test_oracle_with_attackers_of_its_constructor() -> None:
    oracle, world = Oracle(attackers={1, 3}), SimulatedWorld(4, frozenset({1, 3}))
    oracle.reset(4, np.random.default_rng(0))
    assert world.judge(oracle).verdict == defenders.Verdict({0, 2}, {1, 3}, True)
    assert oracle.belief().tolist() == [0, 1, 0, 1]


@pytest.mark.parametrize(("attackers", "complaint"), [(None, "not revealed"), ({0, 1}, "fewer"), ({5}, "fewer")])
def test_oracle_needs_a_truth_that_can_be(attackers: set[int] | None, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        Oracle(attackers=attackers).reset(2, np.random.default_rng(0))
