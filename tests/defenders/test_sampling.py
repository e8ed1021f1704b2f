"""ROBOSAC and PASAC: what they cost with a perfect verifier, and their formulas by hand."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from defenders import Pasac, Prbi, Robosac, Verdict
from defenders.perfect import PerfectWorld
from defenders.robosac import team_size, tries_needed


class Ordered(np.random.Generator):
    """A generator whose every permutation is the same."""

    def __init__(self, order: list[int]) -> None:
        super().__init__(np.random.PCG64(0))
        self.order = np.array(order)

    def permutation(self, x: object) -> np.ndarray:  # type: ignore[override]
        return self.order


class TrustedReference(PerfectWorld):
    """The second view compared, the ego's own, is right even if the ego lies: how the paper's table was counted."""

    def similarity(self, a: int, b: int) -> float:
        return float(self.views[a])


@pytest.mark.parametrize(
    ("k", "mean", "least", "most"), [(0, 2, 2, 2), (1, 4.8, 4, 6), (2, 6.6, 4, 8), (3, 7.6, 6, 8), (4, 8, 8, 8)]
)
def test_pasac_verifications(k: int, mean: float, least: int, most: int) -> None:
    """Exactly, over all sets of liars; the order of halving is fixed, which by symmetry changes nothing."""
    counts = []
    for liars in map(frozenset, itertools.combinations(range(5), k)):
        defender, world = Pasac(trust_ego=False), TrustedReference(5, liars)
        defender.reset(5, Ordered([3, 0, 4, 1, 2]))
        ruling = world.judge(defender)
        counts.append(ruling.verifications)
        assert ruling.verdict == Verdict(frozenset(range(5)) - liars, liars)
    assert np.mean(counts) == pytest.approx(mean)
    assert (min(counts), max(counts)) == (least, most)


@pytest.mark.parametrize(("k", "mean"), [(1, 5), (2, 10), (3, 10), (4, 5)])
def test_robosac_until_success(k: int, mean: float) -> None:
    """Independent teams of n - k, so a geometric number of tries with mean C(n, k)."""
    counts = []
    defender, world = (
        Robosac(reading="until_success", n_attackers=k, trust_ego=False),
        TrustedReference(5, frozenset(range(k))),
    )
    defender.reset(5, np.random.default_rng(0))
    for _ in range(150):
        ruling = world.judge(defender)
        counts.append(ruling.verifications)
        assert ruling.verdict == Verdict(range(k, 5), range(k))
    assert np.mean(counts) == pytest.approx(mean, rel=0.2)
    assert min(counts) == 1


@pytest.mark.parametrize(
    ("eta", "size", "tries"),
    [(0.0, 4, 1), (0.25, 3, 9), (0.5, 2, 17), (0.75, 1, 17), (0.8, 1, 21)],
)
def test_robosac_tries(eta: float, size: int, tries: int) -> None:
    """ln 0.01 / ln(1 - (1-η)^s): 4.605 over 0.548, 0.288, 0.288 and 0.223."""
    assert tries_needed(eta, size, 0.99) == tries


@pytest.mark.parametrize(("eta", "budget", "size"), [(0.2, 5, 2), (0.4, 5, 0), (0.4, 20, 3), (0.2, 20, 7), (0.5, 3, 0)])
def test_robosac_team(eta: float, budget: int, size: int) -> None:
    """ln(1 - 0.01^(1/budget)) / ln(1-η), with numerators -0.508, -1.581 and -0.243 at budgets 5, 20 and 3."""
    assert team_size(eta, budget, 0.99) == size
    assert team_size(0.0, budget, 0.99) == np.inf and team_size(1.0, budget, 0.99) == 0


def test_robosac_budgeted_never_draws_more_than_there_are() -> None:
    """A budget of 20 and one liar in four allow teams of 5; there are three honest ones."""
    defender, world = Robosac(reading="budgeted", n_attackers=1, budget=20), PerfectWorld(5, frozenset({2}))
    defender.reset(5, np.random.default_rng(0))
    ruling = world.judge(defender)
    assert ruling.verdict == Verdict({0, 1, 3, 4}, {2}) and all(len(group) == 4 for group in ruling.groups[1:])


def test_robosac_without_a_team_is_the_ego_alone() -> None:
    defender, world = Robosac(reading="budgeted", n_attackers=2, budget=3), PerfectWorld(5, frozenset({1, 2}))
    defender.reset(5, np.random.default_rng(0))
    ruling = world.judge(defender)
    assert ruling.verdict == Verdict({0}) and ruling.verifications == 0


def test_robosac_probes_the_number_of_liars() -> None:
    defender, world = Robosac(), PerfectWorld(5, frozenset({1, 3}))
    defender.reset(5, np.random.default_rng(0))
    verdicts = [world.judge(defender) for _ in range(40)]
    assert verdicts[0].verdict == Verdict({0}) and verdicts[0].verifications == 1  # all four together fail
    assert defender.probed == 2
    assert any(ruling.verdict == Verdict({0, 2, 4}, {1, 3}) for ruling in verdicts)
    assert max(ruling.verifications for ruling in verdicts) <= 5


def test_pasac_trusts_the_ego() -> None:
    defender, world = Pasac(score="similarity"), PerfectWorld(5, frozenset({1, 3}))
    defender.reset(5, np.random.default_rng(0))
    ruling = world.judge(defender)
    assert ruling.verdict == Verdict({0, 2, 4}, {1, 3})
    assert all(0 in group for group in ruling.groups)


def test_pasac_stops_when_enough_are_accepted() -> None:
    defender, world = Pasac(n_upper=2), PerfectWorld(5, frozenset())
    defender.reset(5, np.random.default_rng(0))
    assert world.judge(defender).verifications == 2


@pytest.mark.parametrize("knobs", [{"score": "iou"}, {"n_upper": 0}])
def test_pasac_refuses(knobs: dict[str, object]) -> None:
    with pytest.raises(ValueError):
        Pasac(**knobs)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "knobs", [{"reading": "x"}, {"reading": "until_success"}, {"n_attackers": -1}, {"budget": 0}, {"confidence": 1.0}]
)
def test_robosac_refuses(knobs: dict[str, object]) -> None:
    with pytest.raises(ValueError):
        Robosac(**knobs)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="below"):
        Robosac(n_attackers=5).reset(5, np.random.default_rng(0))


def test_prbi_asks_less_than_both() -> None:
    """The paper's Table 2 in one line: two a frame, after the first."""
    defender, world = Prbi(stopping="never"), PerfectWorld(5, frozenset({1, 3}))
    defender.reset(5, np.random.default_rng(0))
    world.judge(defender, lying=False)
    world.judge(defender)
    assert max(world.judge(defender).verifications for _ in range(20)) <= 2
