"""Readings of Algorithm 1: what each does to the figures under a perfect verifier, and what is refused."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from defenders import Prbi, Reading, RobustPrbi
from defenders.prbi import defender as module
from defenders.simulation.statistics import EpisodeStats, play_many
from defenders.simulation.world import Scenario, SimulatedWorld

EVEN = Prbi(reading=Reading(first="even", second="nearest", ties="index", flagged="zeros"))
INDEPENDENT = Prbi(
    rounding="nearest", reading=Reading(split="replace", first="independent", second="nearest", ties="index")
)


def statistics(defender: Prbi, k: int, *, in_front: bool, episodes: int = 150) -> EpisodeStats:
    """Episodes of five vehicles, with the attackers drawn, or the vehicles 0 … k - 1."""
    benign = range(k, 5) if in_front else ()
    scenario = Scenario(n_vehicles=5, n_attackers=k, benign=benign, max_frames=99)
    return play_many(defender, scenario, episodes=episodes, seed=k)


def test_the_default_draws_nothing_more() -> None:
    """The reading of the lines one by one: it never divides at random, so its stream is what it was."""
    plain, named = Prbi(), Prbi(reading=Reading(first="m", flagged="rounded"))
    for k in (1, 3):
        one, other = (statistics(defender, k, in_front=False, episodes=10) for defender in (plain, named))
        assert (one.verifications == other.verifications).all() and (one.flagged == other.flagged).all()


@pytest.mark.parametrize(("k", "mean"), [(1, 2.0), (2, 3.0), (4, 6.2)])
def test_verifications_of_a_first_frame_of_even_size(k: int, mean: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Over all sizes and orders.

    k = 2: the groups of s and 5 - s part the attackers with probability s (5 - s) / 10, so in half of all cases. Then
    the larger group has one attacker among three or four, and one of its halves passes: 2 + 2 · 1/2 verifications.
    k = 4: with s = 1 and 4 the benign vehicle is alone (2), or found in the first or second pair of four (6 or 8), 6 on
    average; with s = 2 and 3 it is one of three (4 or 6, twice as often 6), or one of two (8), so 6.4.
    """
    counts = []
    for size, order in itertools.product(range(1, 5), itertools.permutations(range(5))):
        monkeypatch.setattr(module, "even_split", lambda *_, s=size, o=order: (list(o[:s]), list(o[s:])))
        defender, world = Prbi(reading=Reading(first="even")), SimulatedWorld(5, frozenset(range(k)))
        defender.reset(5, np.random.default_rng(0))
        world.judge(defender, attack=False)
        counts.append(world.judge(defender).verifications)
    assert np.mean(counts) == pytest.approx(mean)


@pytest.mark.parametrize("k", [1, 2, 3, 4])
def test_an_even_first_group_misses_no_attacker(k: int) -> None:
    """The reading that comes nearest to the paper's frames, with the attackers in front as there."""
    front, drawn = (statistics(EVEN, k, in_front=place) for place in (True, False))
    for stats in (front, drawn):
        assert stats.converged.all() and (stats.identified == 1).all()
    assert front.false_accusation_rate.mean() <= 0.1
    if k in (2, 3):
        assert drawn.false_accusation_rate.mean() > 0.2  # benign vehicles stand in front of attackers then


@pytest.mark.parametrize("k", [1, 2, 3, 4])
def test_independent_groups_and_rounding_everywhere_misclassify_nobody_in_front(k: int) -> None:
    """The reading that comes nearest to the paper's counts."""
    stats = statistics(INDEPENDENT, k, in_front=True)
    assert (stats.identified == 1).all() and not stats.false_accusation_rate.any()


def shortest(leaves: int) -> int:
    """Sum of the depths of a binary tree of least depth."""
    halves = ((part, leaves - part) for part in range(1, leaves))
    return 0 if leaves == 1 else leaves + min(shortest(a) + shortest(b) for a, b in halves)


def test_one_attacker_of_five_takes_twelve_fifths_of_a_frame() -> None:
    """With one attacker a group fails where the other passes, so a frame gives one bit, and five equally likely leaves
    of a binary tree are 2, 2, 2, 3 and 3 deep. No rule that misclassifies nobody is faster; with a first split of 4 + 1
    the leaves are 1, 3, 3, 3 and 3 deep."""
    assert shortest(5) == 12 and 5 + shortest(1) + shortest(4) == 13
    for defender in (RobustPrbi(), Prbi()):
        stats = statistics(defender, 1, in_front=False, episodes=150)
        assert stats.exact_identification.all() and stats.frames.mean() > 13 / 5 - 0.05


def test_zeros_are_flagged_where_m_is_rounded_up() -> None:
    """m = 1.51 is rounded to 2 in the second condition; Eq. (13) with ⌊m⌋ would flag one of the two attackers."""
    rounded = Prbi(reading=Reading(second="nearest"))
    zeros = Prbi(reading=Reading(second="nearest", flagged="zeros"))
    missed, found = (statistics(defender, 2, in_front=False).identified.mean() for defender in (rounded, zeros))
    assert missed < 0.8 and found == 1


@pytest.mark.parametrize(
    ("options", "known"),
    [
        ({"split": "twice"}, "once, halves, members, replace"),
        ({"second": "up"}, "floor, nearest, ceiling"),
        ({"mean": "median"}, "m, floor"),
        ({"ties": "last"}, "random, index"),
        ({"first": "half"}, "m, even, independent"),
        ({"flagged": "all"}, "rounded, zeros"),
    ],
)
def test_an_unknown_option_is_refused(options: dict[str, str], known: str) -> None:
    with pytest.raises(ValueError, match=known):
        Reading(**options)  # type: ignore[arg-type]


@pytest.mark.parametrize("option", [{"second": "nearest"}, {"mean": "floor"}, {"first": "even"}, {"flagged": "zeros"}])
def test_robust_refuses_what_it_would_not_read(option: dict[str, str]) -> None:
    with pytest.raises(ValueError, match=r"has no effect in it; leave \w+ out, or use 'prbi'"):
        RobustPrbi(reading=Reading(**option))  # type: ignore[arg-type]
