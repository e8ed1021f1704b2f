"""The example defender is what it says: short, and right under a perfect verifier."""

from __future__ import annotations

import inspect

import pytest

from defenders import Reading
from defenders.simulation.world import play
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
    figures = prbi_perfect.measure(prbi_perfect.Args(episodes=25), 2, Reading())
    assert (figures.least, figures.most) == (2, 4)
    assert figures.identified.mean == 100 and figures.unsettled == 0
    assert figures.first.low <= 2.8 <= figures.first.high
    prbi_perfect.main(prbi_perfect.Args(episodes=2, n=3))
    assert "perfect verifier, n = 3" in capsys.readouterr().out
