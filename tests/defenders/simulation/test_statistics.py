"""Numbers kept of many episodes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import defenders
from defenders import NoDefence, Query, Verdict
from defenders.protocol import Frame, Inspection
from defenders.simulation.statistics import members, play_many
from defenders.simulation.verifier import ErrorRates
from defenders.simulation.world import Scenario, every


@settings(max_examples=10)
@given(st.sampled_from(("prbi", "robosac", "pasac", "oracle")), st.integers(3, 8), st.integers(0, 2**32))
def test_any_episode_of_a_batch_can_be_played_alone(name: str, n: int, seed: int) -> None:
    scenario = Scenario(
        n_vehicles=n, n_attackers=n // 2, similarity_model=ErrorRates(0.2, 0.2), max_frames=6, benign={0}
    )
    stats = play_many(defenders.make(name), scenario, episodes=3, seed=seed)
    for i in range(3):
        episode = scenario.play(defenders.make(name), np.random.SeedSequence([seed, i]))
        played = len(episode.results)
        assert stats.frames[i] == played and stats.converged[i] == episode.converged
        assert stats.verifications[i].tolist() == episode.verifications + [-1] * (len(stats.verifications[i]) - played)
        sets = [[*np.flatnonzero(row)] for row in members(stats.flagged[i, :played], n)]
        assert sets == [sorted(result.verdict.suspects) for result in episode.results]
        assert (stats.exact_identification[i], *np.flatnonzero(stats.flagged_last[i])) == (
            episode.suspects == episode.attackers,
            *sorted(episode.suspects),
        )


class Scripted(NoDefence):
    """Flags as scripted, and pays as many verifications of vehicle 0 as the frame's number."""

    flagged = ((), (1, 2), (2,), (1, 2))

    def inspect(self, frame: Frame) -> Inspection:
        yield Query([{0}] * frame.index)
        return Verdict({0, 3}, self.flagged[frame.index])


def test_numbers_worked_by_hand() -> None:
    """Vehicle 3 of four attacks from frame 2 on; 1 and 2 are benign."""
    scenario = Scenario(
        n_vehicles=4, n_attackers=1, benign={0, 1, 2}, schedule=every(1, start=2), grace_frames=0, max_frames=4
    )
    stats = play_many(Scripted(), scenario, episodes=2, seed=0)
    assert stats.verifications.tolist() == [[0, 1, 2, 3]] * 2
    assert stats.first_abnormal.tolist() == [2, 2] and stats.first.tolist() == [2, 2]
    assert stats.all_verifications.tolist() == [0, 1, 2, 3] * 2
    assert stats.attackers.tolist() == [8, 8] and stats.flagged[0].tolist() == [0, 6, 4, 6]
    assert stats.flagged_since[0].tolist() == [-1, 3, 1, -1]
    assert stats.identified.tolist() == [0, 0] and stats.false_accusation_rate == pytest.approx([2 / 3] * 2)
    assert stats.fused_attackers[0].tolist() == [0, 0, 1, 1]
    assert not stats.exact_identification.any() and not stats.converged.any()
