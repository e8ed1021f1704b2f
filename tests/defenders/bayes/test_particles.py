"""Particles against the exact posterior."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from defenders.bayes.likelihood import Verifier
from defenders.bayes.particles import Particles, drawn
from defenders.bayes.posterior import Comparison, Posterior
from tests.defenders.bayes.test_posterior import OFTEN, SWITCH_PROB


@pytest.mark.parametrize("seed", range(3))
def test_particles_are_near_the_exact_posterior(seed: int) -> None:
    n, table = 7, Verifier(0.05, 0.05).tables(7)[0]
    rng = np.random.default_rng(seed)
    exact, sample = Posterior(n, switch_prob=SWITCH_PROB), Particles(n, switch_prob=SWITCH_PROB, size=4000, rng=rng)
    everyone = np.ones(n, dtype=bool)
    for posterior in (exact, sample):
        drawing = np.random.default_rng(seed)
        for t in range(6):
            posterior.predict(OFTEN)
            posterior.update(Comparison(everyone, everyone, table, int(t % 3 == 0)))
            for _ in range(2):
                group = drawing.random(n) < 0.3
                group[drawing.integers(n)] = True
                posterior.update(Comparison(group, everyone, table, int(not group[2])))
            posterior.advance(t % 2 == 0)
            assert posterior.mass.sum() == pytest.approx(1, abs=1e-6)
    assert sample.attacker_probability() == pytest.approx(exact.attacker_probability(), abs=0.1)
    assert sample.likeliest() == pytest.approx(exact.likeliest(), abs=0.1)


def test_particles_replay_what_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("defenders.bayes.particles.MEMORY", 6)
    table, everyone = Verifier().tables(9)[0], np.ones(9, dtype=bool)
    sample = Particles(9, switch_prob=SWITCH_PROB, size=100, rng=np.random.default_rng(0))
    for t in range(15):  # beyond what is remembered: a summary takes its place
        sample.predict(OFTEN)
        sample.update(Comparison(everyone, everyone, table, int(t in (0, 8, 9))))
        sample.update(Comparison(np.arange(9) == t % 9, everyone, table, int(t % 9 != 4 or t in (0, 8, 9))))
        sample.advance(t % 2 == 0)
        assert sample.replay(sample.sets) == pytest.approx(sample.density, rel=1e-6)


@given(st.integers(1, 30), st.integers(0, 10**6))
def test_particles_are_drawn_from_the_prior(n: int, seed: int) -> None:
    numbers = drawn(n, 10 * n, np.random.default_rng(seed)).sum(1)
    assert np.bincount(numbers, minlength=n).tolist() == [10] * n
