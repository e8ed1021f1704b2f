"""PASAC: what it costs with a perfect verifier, and its options."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from defenders import Pasac, Verdict
from defenders.simulation.world import SimulatedWorld
from tests.defenders.test_robosac import Ordered


@pytest.mark.parametrize(
    ("k", "mean", "least", "most"), [(0, 2, 2, 2), (1, 4.8, 4, 6), (2, 6.6, 4, 8), (3, 7.6, 6, 8), (4, 8, 8, 8)]
)
def test_pasac_verifications(k: int, mean: float, least: int, most: int) -> None:
    """Five collaborators and a trusted ego, exactly: over all sets of attackers, for one order of halving."""
    counts = []
    for attackers in map(frozenset, itertools.combinations(range(1, 6), k)):
        defender, world = Pasac(), SimulatedWorld(6, attackers)
        defender.reset(6, Ordered([3, 1, 4, 5, 2]))
        result = world.judge(defender)
        counts.append(result.verifications)
        assert result.verdict == Verdict(frozenset(range(6)) - attackers, attackers)
        assert all(0 in group for group in result.groups)
    assert np.mean(counts) == pytest.approx(mean)
    assert (min(counts), max(counts)) == (least, most)


@pytest.mark.parametrize("k", [0, 1, 3])
def test_pasac_visits_all(k: int) -> None:
    """2n - 1 nodes of the tree over n, whatever is found, and the same verdict."""
    defender, world = Pasac(visit_all=True), SimulatedWorld(6, frozenset(range(1, k + 1)))
    defender.reset(6, np.random.default_rng(0))
    result = world.judge(defender)
    assert result.verifications == 9 and len(set(result.groups[1:])) == 9
    assert result.verdict == Verdict(frozenset(range(6)) - world.attackers, world.attackers)


def test_pasac_enough_is_enough() -> None:
    """Depth first: of five benign collaborators the half of two suffices; the others are neither fused nor flagged."""
    defender, world = Pasac(n_upper=2), SimulatedWorld(6, frozenset())
    defender.reset(6, Ordered([3, 1, 4, 5, 2]))
    result = world.judge(defender)
    assert result.verifications == 1 and result.verdict == Verdict({0, 3, 1})
    world = SimulatedWorld(6, frozenset({3}))
    defender.reset(6, Ordered([3, 1, 4, 5, 2]))
    result = world.judge(defender)
    assert result.groups[1:] == tuple(map(frozenset, ({0, 3, 1}, {0, 3}, {0, 1}, {0, 4, 5, 2})))
    assert result.verdict == Verdict({0, 1, 4, 5, 2}, {3})


@pytest.mark.parametrize(
    "options", [{"score": "iou"}, {"n_upper": 0}, {"n_upper": 2, "visit_all": True}, {"threshold": "my own"}]
)
def test_pasac_refuses(options: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=next(iter(options))):
        Pasac(**options)  # type: ignore[arg-type]
