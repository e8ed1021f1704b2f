"""What is kept between episodes: shared by equal densities, bounded, read-only, and the same through copies."""

from __future__ import annotations

import copy
import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from defenders import Bayes
from defenders.bayes import fleet as module
from defenders.bayes.fleet import FLEETS, REFERENCES, Fleet, open_fleet
from defenders.bayes.histograms import Calibrated, open_likelihood
from defenders.bayes.information import Reference
from defenders.bayes.likelihood import Likelihood, Verifier
from defenders.simulation.statistics import play_many
from defenders.simulation.world import Scenario
from tests.helpers.densities import made_up


def arrays(fleet: Fleet, reference: Reference) -> list[np.ndarray]:
    """All arrays that a fleet and one of its references hold."""
    assert reference.full_view is not None
    holders = [reference, reference.table, reference.full_view, reference.full_view.table, *fleet.tables]
    found = [value for holder in holders for value in vars(holder).values() if isinstance(value, np.ndarray)]
    return [*found, fleet.utility, fleet.members(frozenset({0}))]


@pytest.mark.parametrize("n", [2, 5, 8])
@pytest.mark.parametrize("likelihood", [Verifier(), made_up(0), open_likelihood("calibrated")], ids=["v", "m", "c"])
def test_nothing_that_is_kept_can_be_written_to(likelihood: Likelihood, n: int) -> None:
    fleet = open_fleet(likelihood, n, True)
    found = arrays(fleet, fleet.reference(frozenset({0}), 1, frozenset(range(n))))
    assert len(found) > 15
    assert not any(array.flags.writeable for array in [*found, likelihood.edges, likelihood.full_view_edges])
    if isinstance(likelihood, Calibrated):
        assert not likelihood.uncontaminated(1, 1, 1, 1).flags.writeable


def test_equal_densities_share_a_fleet_and_others_do_not() -> None:
    assert open_fleet(made_up(1), 4, True) is open_fleet(made_up(1), 4, True)
    assert open_fleet(Verifier(0.1, 0.2), 4, True) is open_fleet(Verifier(0.1, 0.2), 4, True)
    others = [(made_up(2), 4, True), (made_up(1), 5, True), (made_up(1), 4, False), (Verifier(0.2, 0.1), 4, True)]
    assert all(open_fleet(*other) is not open_fleet(made_up(1), 4, True) for other in others)
    assert made_up(1) == made_up(1) != made_up(2) and hash(made_up(1)) == hash(made_up(1))
    assert made_up(1) != Verifier()


def test_densities_of_ones_own_are_kept_by_their_defender_alone() -> None:
    """They may not be read-only, and may not be known by their values."""

    class Mine(Verifier):
        __hash__ = None  # type: ignore[assignment]

    defender = Bayes(likelihood=Mine())
    defender.reset(3, np.random.default_rng(0))
    fleet = defender.fleet
    defender.reset(3, np.random.default_rng(1))
    assert defender.fleet is fleet
    other = Bayes(likelihood=Mine())
    other.reset(3, np.random.default_rng(0))
    assert other.fleet is not fleet


def test_copies_share_it_and_a_pickle_holds_the_densities_alone() -> None:
    fleet = open_fleet(made_up(3), 5, True)
    fleet.reference(frozenset({1}), 1, frozenset(range(5)))
    assert copy.deepcopy(fleet) is fleet
    pickled = pickle.dumps(fleet)
    assert pickle.loads(pickled) is fleet
    for group in range(5):
        fleet.reference(frozenset({group}), 2, frozenset(range(5)))
    assert len(pickle.dumps(fleet)) == len(pickled)


def test_it_is_bounded() -> None:
    fleet = open_fleet(made_up(4), 12, True)
    for age in range(1, 30):
        assert fleet.reference(frozenset({3}), age) is fleet.reference(frozenset({3}), min(age, 2))
    for code in range(1, 2 * REFERENCES):
        group = frozenset(np.flatnonzero(code >> np.arange(12) & 1).tolist())
        fleet.reference(group, 1, group)
    assert fleet._reference.cache_info().currsize == fleet.members.cache_info().currsize == REFERENCES
    assert fleet._full_view_table.cache_info().currsize == FLEETS
    for n in range(1, 2 * FLEETS):
        open_fleet(Verifier(), n, True)
    assert module._kept_fleet.cache_info().currsize == FLEETS


@pytest.mark.parametrize("n", [4, 6])
def test_episodes_leave_nothing_in_it(n: int) -> None:
    """After episodes, every array is that of a fleet that has seen none."""
    likelihood, everyone = open_likelihood("calibrated"), frozenset(range(n))
    played, fresh = open_fleet(likelihood, n, True), Fleet(likelihood, n, True)
    defender = Bayes()
    for k in range(n):
        defender_stats(defender, n, k)
    assert defender.fleet is played
    for group in (everyone, frozenset({0}), frozenset({1, 2})):
        for age in (1, 3):
            one, other = (fleet.reference(group, age, everyone) for fleet in (played, fresh))
            pairs = list(zip(arrays(played, one), arrays(fresh, other), strict=True))
            assert all(a.dtype == b.dtype and (a == b).all() for a, b in pairs)


def defender_stats(defender: Bayes, n: int, k: int) -> list[list[int]]:
    stats = play_many(defender, Scenario(n_vehicles=n, n_attackers=k, max_frames=6), episodes=4, seed=0)
    return [stats.verifications.tolist(), stats.fused.tolist(), stats.flagged.tolist()]


def test_threads_play_the_same_episodes() -> None:
    """Several defenders at once, from empty tables on."""
    module._kept_fleet.cache_clear()
    with ThreadPoolExecutor(8) as pool:
        together = list(pool.map(lambda i: defender_stats(Bayes(), 5, i % 4 + 1), range(16)))
    assert together == [defender_stats(Bayes(), 5, i % 4 + 1) for i in range(16)]
