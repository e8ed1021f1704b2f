"""ROBOSAC and PASAC: what they cost with a perfect verifier, and their formulas by hand."""

from __future__ import annotations

import itertools
import json
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chisquare

from defenders import Pasac, Prbi, Robosac, Verdict
from defenders.robosac import team_size, tries_needed
from defenders.simulation.world import PerfectWorld
from defenders.thresholds.tables import EGO_ONLY, read_thresholds
from examples.reproduce import verification_counts


class Ordered(np.random.Generator):
    """A generator whose every permutation is the same."""

    def __init__(self, order: list[int]) -> None:
        super().__init__(np.random.PCG64(0))
        self.order = np.array(order)

    def permutation(self, x: object) -> np.ndarray:  # type: ignore[override]
        return self.order


@pytest.mark.parametrize(
    ("k", "mean", "least", "most"), [(0, 2, 2, 2), (1, 4.8, 4, 6), (2, 6.6, 4, 8), (3, 7.6, 6, 8), (4, 8, 8, 8)]
)
def test_pasac_verifications(k: int, mean: float, least: int, most: int) -> None:
    """Five collaborators beside a trusted ego, exactly: over all sets of liars, for one order of halving."""
    counts = []
    for liars in map(frozenset, itertools.combinations(range(1, 6), k)):
        defender, world = Pasac(), PerfectWorld(6, liars)
        defender.reset(6, Ordered([3, 1, 4, 5, 2]))
        ruling = world.judge(defender)
        counts.append(ruling.verifications)
        assert ruling.verdict == Verdict(frozenset(range(6)) - liars, liars)
        assert all(0 in group for group in ruling.groups)
    assert np.mean(counts) == pytest.approx(mean)
    assert (min(counts), max(counts)) == (least, most)


@pytest.mark.parametrize("k", [0, 1, 3])
def test_pasac_visits_all(k: int) -> None:
    """2n - 1 nodes of the tree over n, whatever is found, and the same verdict."""
    defender, world = Pasac(visit_all=True), PerfectWorld(6, frozenset(range(1, k + 1)))
    defender.reset(6, np.random.default_rng(0))
    ruling = world.judge(defender)
    assert ruling.verifications == 9 and len(set(ruling.groups[1:])) == 9
    assert ruling.verdict == Verdict(frozenset(range(6)) - world.liars, world.liars)


@pytest.mark.slow
def test_table_2_over_20000_episodes(tmp_path: Path) -> None:
    """In a process without shape checks, as the program is run: means to 2 %, minima and PASAC's maxima exactly."""
    program = Path(verification_counts.__file__)
    rows = ("ROBOSAC", "PASAC")
    subprocess.run(
        [sys.executable, program, "--rows", *rows, "--out", tmp_path],
        check=True,
        capture_output=True,
        env={**os.environ, "PYTHONPATH": str(program.parents[2])},
    )
    found = {(row["defender"], row["k"]): row for row in json.loads((tmp_path / "perfect.json").read_text())["rows"]}
    expected = ((1, 5, 4.8, 4, 6), (2, 10, 6.6, 4, 8), (3, 10, 7.6, 6, 8), (4, 5, 8, 8, 8))
    for k, tries, halvings, least, most in expected:
        robosac, pasac = (found[row, k] for row in rows)
        assert robosac["frames"] == pasac["frames"] == 20_000
        assert robosac["mean"] == pytest.approx(tries, rel=0.02) and robosac["least"] == 1
        assert pasac["mean"] == pytest.approx(halvings, rel=0.02)
        assert (pasac["least"], pasac["most"]) == (least, most)


def test_table_2_worked_out_is_what_is_played() -> None:
    """The column "exact" of the program against the defenders, beyond five collaborators."""
    for n, k in ((4, 2), (7, 1), (7, 3)):
        counts = []
        for liars in map(frozenset, itertools.combinations(range(1, n + 1), k)):
            defender, world = Pasac(score="similarity"), PerfectWorld(n + 1, liars)
            defender.reset(n + 1, Ordered(list(range(1, n + 1))))
            counts.append(world.judge(defender).verifications)
        assert np.mean(counts) == pytest.approx(verification_counts.exact("PASAC", n, k))
    assert [verification_counts.exact("ROBOSAC", 5, k) for k in (1, 2, 3, 4)] == [5, 10, 10, 5]


@pytest.mark.parametrize("k", [1, 2, 3, 4])
def test_robosac_until_success(k: int) -> None:
    """A team of n - k is asked until it is the honest one; all C(n, k) teams are as likely."""
    defender = Robosac(reading="until_success", n_attackers=k)
    world = PerfectWorld(6, frozenset(range(1, k + 1)))
    defender.reset(6, np.random.default_rng(0))
    asked: Counter[frozenset[int]] = Counter()
    for _ in range(60):
        ruling = world.judge(defender)
        assert ruling.verdict == Verdict(frozenset(range(6)) - world.liars, world.liars)
        assert ruling.verifications == len(ruling.groups) - 1 and ruling.groups[-1] == ruling.verdict.collaborators
        asked.update(ruling.groups[1:])
    assert set(asked) == {frozenset({0, *g}) for g in itertools.combinations(range(1, 6), 5 - k)}
    assert chisquare(list(asked.values())).pvalue > 0.001


@pytest.mark.parametrize(
    ("liar", "collaborators", "reading"), [(2, {0, 1, 3, 4}, "until_success"), (0, {0}, "replacement")]
)
def test_without_a_trusted_ego_all_vehicles_are_drawn(liar: int, collaborators: set[int], reading: str) -> None:
    """The reference is still the ego's own view: an honest ego is found among the teams, a lying one finds nobody."""
    robosac = Robosac(reading=reading, n_attackers=1, trust_ego=False)
    for defender in (robosac, Pasac(score="similarity", trust_ego=False)):
        world = PerfectWorld(5, frozenset({liar}))
        defender.reset(5, np.random.default_rng(0))
        ruling = world.judge(defender)
        assert ruling.verdict.collaborators == collaborators
        assert not all(0 in group for group in ruling.groups)


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


def test_robosac_a_budget_too_small_for_anybody_is_refused() -> None:
    """Three tries and half of four lying: s = 0. One honest vehicle takes ⌈ln 0.01 / ln 0.5⌉ = 7 tries."""
    with pytest.raises(ValueError, match="it takes 7"):
        Robosac(reading="budgeted", n_attackers=2, budget=3).reset(5, np.random.default_rng(0))


def test_robosac_without_a_team_is_the_ego_alone() -> None:
    """Teams of one of five, two of whom lie (s = 1): six tries miss in (2/5)^6 = 0.4 % of the frames."""
    defender, world = Robosac(reading="budgeted", n_attackers=2, budget=6), PerfectWorld(6, frozenset({1, 2}))
    defender.reset(6, np.random.default_rng(0))
    rulings = [world.judge(defender) for _ in range(500)]
    sizes = {len(ruling.verdict.collaborators) for ruling in rulings}
    assert sizes == {1, 2} and not any(ruling.verdict.suspects for ruling in rulings)
    alone = [ruling for ruling in rulings if ruling.verdict == Verdict({0})]
    assert all(ruling.verifications == 6 for ruling in alone) and 0 < len(alone) < 10


def test_robosac_where_all_others_lie_does_not_try() -> None:
    defender, world = Robosac(n_attackers=4), PerfectWorld(5, frozenset({1, 2, 3, 4}))
    defender.reset(5, np.random.default_rng(0))
    ruling = world.judge(defender)
    assert ruling.verdict == Verdict({0}, {1, 2, 3, 4}) and ruling.verifications == 0


@pytest.mark.parametrize("k", range(5))
def test_robosac_probes_the_ratio_of_liars(k: int) -> None:
    """Five collaborators: the ratios are 0 … 4 liars, given up after 1, 9, 19, 27 and 21 failures."""
    defender, world = Robosac(), PerfectWorld(6, frozenset(range(1, k + 1)))
    defender.reset(6, np.random.default_rng(k))
    assert defender.left == {0: 1, 1: 9, 2: 19, 3: 27, 4: 21}
    rulings = [world.judge(defender) for _ in range(80)]
    assert defender.found == k and not any(defender.left.values())
    assert max(ruling.verifications for ruling in rulings) <= 5
    assert rulings[-1].verifications >= 1
    settled = [ruling.verdict for ruling in rulings[-30:]]
    assert Verdict(frozenset(range(6)) - world.liars, world.liars) in settled
    assert all(not verdict.collaborators & world.liars for verdict in settled)


def test_robosac_probes_the_largest_team_first() -> None:
    """Nobody lies: one try finds it, every frame. One of five does: everyone, then four, three, … in the same frame."""
    defender, world = Robosac(), PerfectWorld(6, frozenset())
    defender.reset(6, np.random.default_rng(0))
    for _ in range(3):
        ruling = world.judge(defender)
        assert ruling.verifications == 1 and ruling.verdict == Verdict(range(6))
    world = PerfectWorld(6, frozenset({2}))
    defender.reset(6, np.random.default_rng(0))
    sizes = [len(group) - 1 for group in world.judge(defender).groups[1:]]
    assert sizes[0] == 5 and sizes[1] == 4
    assert len(sizes) == 5


def test_robosac_ratios_that_round_alike_are_one() -> None:
    """Four collaborators: 0, 0.8, 1.6, 2.4 and 3.2 liars."""
    defender = Robosac()
    defender.reset(5, np.random.default_rng(0))
    assert list(defender.left) == [0, 1, 2, 3]


def test_pasac_enough_is_enough() -> None:
    """Depth first: of five honest collaborators the half of two suffices; the others are neither fused nor accused."""
    defender, world = Pasac(n_upper=2), PerfectWorld(6, frozenset())
    defender.reset(6, Ordered([3, 1, 4, 5, 2]))
    ruling = world.judge(defender)
    assert ruling.verifications == 1 and ruling.verdict == Verdict({0, 3, 1})
    world = PerfectWorld(6, frozenset({3}))
    defender.reset(6, Ordered([3, 1, 4, 5, 2]))
    ruling = world.judge(defender)
    assert ruling.groups[1:] == tuple(map(frozenset, ({0, 3, 1}, {0, 3}, {0, 1}, {0, 4, 5, 2})))
    assert ruling.verdict == Verdict({0, 1, 4, 5, 2}, {3})


def test_thresholds_by_size_and_by_paper() -> None:
    ladder = {1: 0.2, 2: 0.3, 3: 0.6}
    pair, three = frozenset({0, 1}), frozenset({0, 1, 2})
    for defender in (Pasac(threshold=ladder), Robosac(threshold=ladder)):
        assert (defender.epsilon(pair), defender.epsilon(three)) == (0.3, 0.6)
    assert Pasac(threshold="paper").epsilon(three) == 0.08
    assert Pasac(threshold="paper", score="similarity").epsilon(three) == Robosac().epsilon(three) == 0.3
    assert Pasac(epsilon=0.1).epsilon(three) == 0.1
    for score, path in EGO_ONLY.items():
        assert Pasac(score=score).epsilon(pair) == read_thresholds(path)(pair)
    assert Robosac(threshold="calibrated").epsilon(three) == read_thresholds(EGO_ONLY["similarity"])(three)


def test_passing_is_above_for_pasac_and_at_least_for_robosac() -> None:
    world = PerfectWorld(3, frozenset(), likeness=lambda group, lying, rng: 0.3)
    pasac, robosac = Pasac(score="similarity", epsilon=0.3), Robosac(n_attackers=0, epsilon=0.3)
    for defender, accused in ((pasac, {1, 2}), (robosac, set())):
        defender.reset(3, np.random.default_rng(0))
        assert world.judge(defender).verdict.suspects == accused


@pytest.mark.parametrize(
    "knobs", [{"score": "iou"}, {"n_upper": 0}, {"n_upper": 2, "visit_all": True}, {"threshold": "my own"}]
)
def test_pasac_refuses(knobs: dict[str, object]) -> None:
    with pytest.raises(ValueError):
        Pasac(**knobs)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "knobs",
    [
        {"reading": "x"},
        {"reading": "until_success"},
        {"n_attackers": -1},
        {"budget": 4},
        {"n_attackers": 1, "budget": 0},
        {"confidence": 1.0},
        {"ratios": ()},
        {"ratios": (0.0, 1.2)},
        {"epsilon": -1.0},
    ],
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
