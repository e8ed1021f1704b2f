"""The example defender is what it says: short, and right under a perfect verifier."""

from __future__ import annotations

import inspect

import pytest

from defenders import Prbi, Reading
from defenders.simulation.statistics import play_many
from defenders.simulation.world import Scenario, play
from examples import add_a_defender
from examples.reproduce import prbi_perfect


@pytest.mark.parametrize("k", [1, 2, 3, 4])
def test_add_a_defender(k: int) -> None:
    defender = add_a_defender.OneByOne
    assert len(inspect.getsource(defender).splitlines()) <= 25
    for seed in range(5):
        episode = play(defender(), 5, k, seed, max_frames=3)
        assert episode.suspects == episode.attackers
        assert episode.verifications == [5, 5, 5]


def test_prbi_against_the_paper(capsys: pytest.CaptureFixture[str]) -> None:
    figures = prbi_perfect.measure(prbi_perfect.Args(episodes=25), 2, prbi_perfect.Variant("ours", Reading()))
    assert (figures.least, figures.most) == (2, 4)
    assert figures.identified.mean == 100 and figures.unsettled.hits == 0
    assert figures.first.low <= 2.8 <= figures.first.high
    assert figures.false_accusation_rate.mean / 100 <= figures.misclassified_runs.mean
    prbi_perfect.main(prbi_perfect.Args(episodes=2, n=3))
    assert "perfect verifier, n = 3" in capsys.readouterr().out


def test_a_run_that_costs_nothing_in_a_frame_counts_two_there() -> None:
    """k = 1: ⌊m⌋ = 0 leaves one group empty; the paper counts two verifications in every frame."""
    stats = play_many(Prbi(), Scenario(n_vehicles=5, n_attackers=1), episodes=20, seed=0)
    assert stats.all_verifications.min() == 0
    assert (prbi_perfect.run_means(stats) == 2).all()


def test_readings_are_printed_with_the_paper(capsys: pytest.CaptureFixture[str]) -> None:
    prbi_perfect.main(prbi_perfect.Args(episodes=2, readings=True))
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("|")]
    assert len(lines) == 2 + len(prbi_perfect.variants()) + 1
    assert lines[-1].startswith("| the paper | 2.25 2.77 3.36 4.27 | 2.00 2.35 2.61 2.86 | 2.00 2.88 4.06 5.70 |")
    assert len({line.count("|") for line in lines}) == 1
