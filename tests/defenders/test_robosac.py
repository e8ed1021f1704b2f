"""ROBOSAC and PASAC: what they cost with a perfect verifier, and their formulas by hand."""

from __future__ import annotations

import itertools
from collections import Counter

import numpy as np
import pytest
from scipy.stats import chisquare

from defenders import Pasac, Robosac, Verdict
from defenders.robosac import team_size, tries_needed
from defenders.simulation.world import SimulatedWorld


class Ordered(np.random.Generator):
    """A generator whose every permutation is the same."""

    def __init__(self, order: list[int]) -> None:
        super().__init__(np.random.PCG64(0))
        self.order = np.array(order)

    def permutation(self, x: object) -> np.ndarray:  # type: ignore[override]
        return self.order


@pytest.mark.parametrize("k", [1, 2, 3, 4])
def test_robosac_until_success(k: int) -> None:
    """A team of n - k is asked until it is the benign one; all C(n, k) teams are as likely."""
    defender = Robosac(reading="until_success", n_attackers=k)
    world = SimulatedWorld(6, frozenset(range(1, k + 1)))
    defender.reset(6, np.random.default_rng(0))
    asked: Counter[frozenset[int]] = Counter()
    for _ in range(60):
        result = world.judge(defender)
        assert result.verdict == Verdict(frozenset(range(6)) - world.attackers, world.attackers)
        assert result.verifications == len(result.groups) - 1 and result.groups[-1] == result.verdict.collaborators
        asked.update(result.groups[1:])
    assert set(asked) == {frozenset({0, *g}) for g in itertools.combinations(range(1, 6), 5 - k)}
    assert chisquare(list(asked.values())).pvalue > 0.001


@pytest.mark.parametrize(
    ("attacker", "collaborators", "reading"), [(2, {0, 1, 3, 4}, "until_success"), (0, {0}, "replacement")]
)
def test_without_a_trusted_ego_all_vehicles_are_drawn(attacker: int, collaborators: set[int], reading: str) -> None:
    """The reference is still the ego's own view: a benign ego is in a team that passes, a malicious one in none."""
    robosac = Robosac(reading=reading, n_attackers=1, trust_ego=False)
    for defender in (robosac, Pasac(score="similarity", trust_ego=False)):
        world = SimulatedWorld(5, frozenset({attacker}))
        defender.reset(5, np.random.default_rng(0))
        result = world.judge(defender)
        assert result.verdict.collaborators == collaborators
        assert not all(0 in group for group in result.groups)


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
    """A budget of 20 and one attacker in four allow teams of 5; there are three benign ones."""
    defender, world = Robosac(reading="budgeted", n_attackers=1, budget=20), SimulatedWorld(5, frozenset({2}))
    defender.reset(5, np.random.default_rng(0))
    result = world.judge(defender)
    assert result.verdict == Verdict({0, 1, 3, 4}, {2}) and all(len(group) == 4 for group in result.groups[1:])


def test_robosac_a_budget_too_small_for_anybody_is_refused() -> None:
    """Three tries and half of four malicious: s = 0. One benign vehicle takes ⌈ln 0.01 / ln 0.5⌉ = 7 tries."""
    with pytest.raises(ValueError, match="it takes 7"):
        Robosac(reading="budgeted", n_attackers=2, budget=3).reset(5, np.random.default_rng(0))


def test_robosac_without_a_team_is_the_ego_alone() -> None:
    """Teams of one of five, two of which attack (s = 1): six tries miss in (2/5)^6 = 0.4 % of the frames."""
    defender, world = Robosac(reading="budgeted", n_attackers=2, budget=6), SimulatedWorld(6, frozenset({1, 2}))
    defender.reset(6, np.random.default_rng(0))
    results = [world.judge(defender) for _ in range(500)]
    sizes = {len(result.verdict.collaborators) for result in results}
    assert sizes == {1, 2} and not any(result.verdict.suspects for result in results)
    alone = [result for result in results if result.verdict == Verdict({0})]
    assert all(result.verifications == 6 for result in alone) and 0 < len(alone) < 10


def test_robosac_where_all_others_attack_does_not_try() -> None:
    defender, world = Robosac(n_attackers=4), SimulatedWorld(5, frozenset({1, 2, 3, 4}))
    defender.reset(5, np.random.default_rng(0))
    result = world.judge(defender)
    assert result.verdict == Verdict({0}, {1, 2, 3, 4}) and result.verifications == 0


@pytest.mark.parametrize("k", range(5))
def test_robosac_probes_the_ratio_of_attackers(k: int) -> None:
    """Five collaborators: the ratios are 0 … 4 attackers, given up after 1, 9, 19, 27 and 21 failures."""
    defender, world = Robosac(), SimulatedWorld(6, frozenset(range(1, k + 1)))
    defender.reset(6, np.random.default_rng(k))
    assert defender.left == {0: 1, 1: 9, 2: 19, 3: 27, 4: 21}
    results = [world.judge(defender) for _ in range(80)]
    assert defender.found == k and not any(defender.left.values())
    assert max(result.verifications for result in results) <= 5
    assert results[-1].verifications >= 1
    settled = [result.verdict for result in results[-30:]]
    assert Verdict(frozenset(range(6)) - world.attackers, world.attackers) in settled
    assert all(not verdict.collaborators & world.attackers for verdict in settled)


def test_robosac_probes_the_largest_team_first() -> None:
    """Without an attacker one try suffices, every frame. With one of five: everyone, four, three, … in one frame."""
    defender, world = Robosac(), SimulatedWorld(6, frozenset())
    defender.reset(6, np.random.default_rng(0))
    for _ in range(3):
        result = world.judge(defender)
        assert result.verifications == 1 and result.verdict == Verdict(range(6))
    world = SimulatedWorld(6, frozenset({2}))
    defender.reset(6, np.random.default_rng(0))
    sizes = [len(group) - 1 for group in world.judge(defender).groups[1:]]
    assert sizes[0] == 5 and sizes[1] == 4
    assert len(sizes) == 5


def test_robosac_ratios_that_round_alike_are_one() -> None:
    """Four collaborators: 0, 0.8, 1.6, 2.4 and 3.2 attackers."""
    defender = Robosac()
    defender.reset(5, np.random.default_rng(0))
    assert list(defender.left) == [0, 1, 2, 3]


@pytest.mark.parametrize(
    ("options", "rule"),
    [
        ({"reading": "x"}, "reading must"),
        ({"reading": "until_success"}, "needs the number of attackers"),
        ({"n_attackers": -1}, "n_attackers must"),
        ({"budget": 4}, "budget must allow 5"),
        ({"n_attackers": 1, "budget": 0}, "budget must allow 1"),
        ({"confidence": 1.0}, "confidence is"),
        ({"ratios": ()}, "ratios are"),
        ({"ratios": (0.0, 1.2)}, "ratios are"),
        ({"epsilon": -1.0}, "a threshold is"),
    ],
)
def test_robosac_refuses(options: dict[str, object], rule: str) -> None:
    with pytest.raises(ValueError, match=rule):
        Robosac(**options)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="below"):
        Robosac(n_attackers=5).reset(5, np.random.default_rng(0))
