"""PRBI under a perfect verifier: the paper's theorems, the count table, and every branch of Algorithm 1 by hand."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from defenders import Prbi, Query, Reading, Verdict
from defenders.prbi.inference import benign_ratio
from defenders.prbi.interpretation import ROUNDINGS
from defenders.protocol import View
from defenders.simulation.world import SimulatedWorld, play


class Ordered(np.random.Generator):
    """A generator whose every permutation is the same."""

    def __init__(self, order: Sequence[int]) -> None:
        super().__init__(np.random.PCG64(0))
        self.order = np.array(order)

    def permutation(self, n: int) -> np.ndarray:  # type: ignore[override]
        return self.order


@pytest.mark.parametrize(
    ("k", "mean", "least", "most"), [(1, 2.0, 2, 2), (2, 2.8, 2, 4), (3, 4.0, 2, 6), (4, 6.0, 2, 8)]
)
def test_verifications_of_the_first_abnormal_frame(k: int, mean: float, least: int, most: int) -> None:
    """Exactly, over all orders in which ties can fall."""
    counts = []
    for order in itertools.permutations(range(5)):
        defender, world = Prbi(), SimulatedWorld(5, frozenset(range(k)))
        defender.reset(5, Ordered(order))
        world.judge(defender, attack=False)
        counts.append(world.judge(defender).verifications)
    assert np.mean(counts) == pytest.approx(mean)
    assert (min(counts), max(counts)) == (least, most)


@pytest.mark.parametrize("k", [1, 2, 3, 4])
def test_no_attacker_is_missed_and_later_frames_cost_two(k: int) -> None:
    for seed in range(40):
        episode = play(Prbi(), 5, k, seed)
        assert episode.converged
        assert episode.attackers <= episode.suspects
        assert max(episode.verifications[1:]) <= 2


@pytest.mark.parametrize("k", [1, 4])
def test_no_benign_vehicle_is_convicted_at_the_ends(k: int) -> None:
    """In between the published stopping rule does convict benign vehicles; see `Reading`."""
    episodes = [play(Prbi(), 5, k, seed) for seed in range(60)]
    assert all(episode.suspects == episode.attackers for episode in episodes)


def watch(n: int, k: int, seed: int, frames: int, **options: object) -> tuple[Prbi, list[float]]:
    """m after each frame of an episode that never stops."""
    defender, world = Prbi(stopping="never", **options), SimulatedWorld(n, frozenset(range(k)))  # type: ignore[arg-type]
    defender.reset(n, np.random.default_rng(seed))
    world.judge(defender, attack=False)
    values = []
    for _ in range(frames):
        world.judge(defender)
        values.append(defender.m)
    return defender, values


fleets = st.integers(2, 8).flatmap(lambda n: st.tuples(st.just(n), st.integers(1, n - 1)))


@settings(max_examples=6)
@given(fleets, st.integers(0, 2**32))
def test_theorem_1_m_converges_to_k(fleet: tuple[int, int], seed: int) -> None:
    n, k = fleet
    defender, values = watch(n, k, seed, 300)
    assert np.mean(values[-100:]) == pytest.approx(k, abs=0.1)
    assert benign_ratio(defender.normal, defender.total) == pytest.approx(2.0**-k, rel=0.1)  # Table 1
    assert set(np.flatnonzero(defender.probability == 0)) == set(range(k))


@settings(max_examples=12)
@given(fleets, st.integers(0, 2**32))
def test_theorem_1_every_step_points_at_k(fleet: tuple[int, int], seed: int) -> None:
    """Once the attackers alone have probability zero, ⌊m⌋ < k makes m grow and ⌊m⌋ >= k makes it shrink, to the cap."""
    n, k = fleet
    defender, world = Prbi(stopping="never"), SimulatedWorld(n, frozenset(range(k)))
    defender.reset(n, np.random.default_rng(seed))
    world.judge(defender, attack=False)
    for _ in range(60):
        known = set(np.flatnonzero(defender.probability == 0)) == set(range(k))
        before = defender.m
        world.judge(defender)
        if known and math.floor(before) < k:
            assert before < defender.m <= n - 1 or defender.m == n - 1
        elif known:
            assert defender.m < before or before == defender.m == n - 1


@settings(max_examples=5)
@given(fleets.filter(lambda fleet: 4 <= fleet[0] < 8), st.sampled_from(ROUNDINGS), st.integers(0, 2**32))
def test_theorem_2_rounding(fleet: tuple[int, int], rounding: str, seed: int) -> None:
    """η cannot exceed (n - k) / n, so m stays above log2(n / (n - k)): the theorem's exception at k = 1."""
    n, k = fleet
    limit = {"floor": k, "nearest": k - 0.5, "ceiling": k - 1}[rounding]
    _, values = watch(n, k, seed, 250, rounding=rounding)
    assert np.mean(values[-100:]) == pytest.approx(max(limit, math.log2(n / (n - k))), abs=0.1)


@pytest.mark.parametrize("rounding", ["nearest", "ceiling"])
def test_theorem_2_does_not_hold_for_three_vehicles(rounding: str) -> None:
    """k = 2: one vehicle of three passes in every frame, η = 1 / 3, and m = log2 3 is rounded to 2, and so on."""
    _, values = watch(3, 2, 0, 250, rounding=rounding)
    assert np.mean(values[-100:]) == pytest.approx(math.log2(3), abs=0.05)


@pytest.mark.parametrize("k", [1, 2, 3, 4])
def test_eq_3_is_the_share_of_clean_groups(k: int) -> None:
    """Table 1, theory: of all groups of 5 vehicles, (2^(n-k) - 1) / (2^n - 1) hold no attacker."""
    groups = [set(g) for size in range(1, 6) for g in itertools.combinations(range(5), size)]
    share = sum(g.isdisjoint(range(k)) for g in groups) / len(groups)
    assert share == pytest.approx([0.484, 0.226, 0.097, 0.032][k - 1], abs=5e-4)
    assert share == (2 ** (5 - k) - 1) / (2**5 - 1)


# -- by hand: views are strings, similarity is what the test says ----------------------------------------------------


class Script:
    """Drives one defender with answers written by the test."""

    def __init__(self, defender: Prbi, n: int) -> None:
        self.defender, self.index, self.n_vehicles, self.present = defender, 0, n, frozenset(range(n))
        self.order = [3, 0, 4, 1, 2][:n] if n == 5 else list(range(n))  # how ties fall
        defender.reset(n, Ordered(self.order))

    def frame(self, similarity_of: Callable[[frozenset[int]], float]) -> tuple[Verdict, list[Query]]:
        """`similarity_of` of a group's view to whatever the reference is."""
        self.seen: View = (self.index, frozenset(range(self.n_vehicles)))
        self.similarity_of = similarity_of
        inspection, queries = self.defender.inspect(self), []
        try:
            answer: list[View] | None = None
            while True:
                queries.append(inspection.send(answer) if answer is not None else next(inspection))
                answer = [(self.index, group) for group in queries[-1].groups]
        except StopIteration as stop:
            self.index += 1
            return stop.value, queries

    def similarity(self, a: View, b: View) -> float:
        return self.similarity_of(max(a, b, key=lambda view: view[0] == self.index)[1])

    def agreement(self, a: View, b: View) -> float:
        return 0.0


def against(attackers: set[int]) -> Callable[[frozenset[int]], float]:
    return lambda group: float(group.isdisjoint(attackers))


def benign(group: frozenset[int]) -> float:
    return 0.8


def test_the_first_frame_is_trusted_and_normal_frames_are_free() -> None:
    script = Script(Prbi(), 5)
    for _ in range(3):
        verdict, queries = script.frame(benign)
        assert verdict == Verdict(range(5)) and not queries
        assert script.defender.reference == script.seen  # kept fresh
    assert not script.defender.belief().any()


def test_a_view_exactly_at_epsilon_passes() -> None:
    script = Script(Prbi(), 5)
    script.frame(benign)
    assert script.frame(lambda group: 0.35)[1] == []
    assert script.frame(lambda group: 0.3499)[1] != []


def test_one_attacker_singled_out_at_once() -> None:
    """m = n - 1 = 4, so groups of 4 and 1; the single is the attacker; m = log2(5/4), and a frame later log2(10/4)."""
    script = Script(Prbi(), 5)
    attacker, others = script.order[4], frozenset(script.order[:4])
    script.frame(benign)
    verdict, queries = script.frame(against({attacker}))
    assert queries == [Query([others, {attacker}])]  # and the output is a view already seen
    assert verdict == Verdict(others, ())  # ⌊m⌋ = 0: nobody is flagged yet
    assert script.defender.m == pytest.approx(math.log2(5 / 4))
    assert script.defender.belief() == pytest.approx([1.0 if i == attacker else 1 - 0.8125 for i in range(5)])
    assert script.defender.reference == (1, others)

    verdict, queries = script.frame(against({attacker}))  # ⌊m⌋ = 0: everyone again, which was seen to fail
    assert queries == []
    assert script.defender.m == pytest.approx(math.log2(10 / 4))
    assert verdict == Verdict(others, {attacker}, converged=True)  # ⌊m⌋ = 1 vehicle of probability zero

    verdict, queries = script.frame(against({0, 1, 2}))  # afterwards nothing is verified
    assert verdict == Verdict(others, {attacker}, converged=True) and queries == []


def test_normal_frames_before_convergence_exclude_the_attackers() -> None:
    """Group 4 | 1, the single passes: m = log2 5, two of the four others are Attackers, and line 41 leaves them out."""
    script = Script(Prbi(), 5)
    single = script.order[4]
    script.frame(benign)
    verdict, queries = script.frame(against({script.order[0]}))
    assert verdict.collaborators == {single} and len(verdict.suspects) == 2
    later, queries = script.frame(benign)
    assert later == Verdict(set(range(5)) - verdict.suspects, verdict.suspects)
    assert queries == [Query([later.collaborators], verification=False)]
    assert script.defender.reference == (2, later.collaborators)
    _, queries = script.frame(against({script.order[0]}))
    assert queries[0].groups[0] == verdict.suspects  # Attackers are the next first group


def test_divide_and_conquer_is_depth_first() -> None:
    """k = 4, the benign one last in the second half of the group of four: 2 + 2 + 2 + 2 verifications."""
    script = Script(Prbi(), 5)
    a, b, c, d, e = script.order
    script.frame(benign)
    verdict, queries = script.frame(against({a, b, c, e}))
    assert queries == [Query(pair) for pair in ([{a, b, c, d}, {e}], [{a, b}, {c, d}], [{a}, {b}], [{c}, {d}])]
    assert verdict.collaborators == {d}
    assert script.defender.normal[d] == 1 and script.defender.normal.sum() == 1
    assert (script.defender.total == 2).all()
    assert script.defender.reference == (1, frozenset({d}))


@pytest.mark.parametrize(
    ("reading", "normal", "total"),
    [
        (Reading(), [0, 0, 0, 1, 0], [2, 2, 2, 2, 2]),
        (Reading(split="replace"), [0, 0, 0, 1, 0], [1, 1, 1, 1, 1]),
        (Reading(split="halves"), [0, 0, 0, 1, 0], [4, 4, 4, 4, 4]),
        (Reading(split="members"), [0, 0, 0, 1, 0], [3, 3, 3, 3, 1]),
    ],
)
def test_what_divide_and_conquer_adds_to_the_counts(reading: Reading, normal: list[int], total: list[int]) -> None:
    for refresh in (False, True):
        script = Script(Prbi(reading=Reading(reading.split, refresh)), 5)
        order = script.order
        script.frame(benign)
        script.frame(against({order[0], order[1], order[2], order[4]}))
        assert script.defender.normal[order].tolist() == normal
        assert script.defender.total[order].tolist() == total
        assert (script.defender.probability > 0).any() == refresh


def test_nobody_passes_at_all() -> None:
    """The most similar view is the output, the old reference stays, and the search is not repeated."""
    script = Script(Prbi(), 5)
    script.frame(benign)
    first = script.defender.reference
    verdict, queries = script.frame(lambda group: 0.3 if group == {2} else 0.1)
    assert verdict.collaborators == {2}
    assert sum(len(query.groups) for query in queries) == 8
    assert script.defender.reference == first
    _, queries = script.frame(lambda group: 0.0)
    assert [len(query.groups) for query in queries] == [2]


def test_two_vehicles_that_both_fail_cannot_be_halved() -> None:
    script = Script(Prbi(), 2)
    script.frame(benign)
    verdict, queries = script.frame(lambda group: 0.2 if group == {1} else 0.0)
    assert verdict.collaborators == {1} and len(queries) == 1


def test_everyone_passes_in_groups_but_not_together() -> None:
    """P(A) = 0: a false alarm; nobody is at zero, everyone is fused, and that view is known."""
    script = Script(Prbi(), 5)
    script.frame(benign)
    verdict, queries = script.frame(lambda group: float(len(group) < 5))
    assert verdict == Verdict(range(5)) and len(queries) == 1
    assert not script.defender.converged


def test_a_threshold_for_each_group_size() -> None:
    script = Script(Prbi(threshold={1: 0.2, 2: 0.3, 3: 0.5, 4: 0.7, 5: 0.75}), 5)
    script.frame(benign)
    verdict, _ = script.frame(lambda group: {1: 0.25, 4: 0.6, 5: 0.74}[len(group)])
    assert verdict.collaborators == {script.order[4]}  # 0.6 fails for four, 0.25 passes for one


def test_smaller_alpha_never_stops_later() -> None:
    def frames(alpha: float, seeds: Sequence[int]) -> float:
        return float(np.mean([len(play(Prbi(alpha=alpha), 5, 2, seed).results) for seed in seeds]))

    assert frames(0.01, range(80)) < frames(0.2, range(80))


@pytest.mark.parametrize(
    ("options", "rule"),
    [
        ({"epsilon": 1.5}, "a threshold is"),
        ({"rounding": "up"}, "rounding must"),
        ({"stopping": "soon"}, "stopping must"),
        ({"threshold": "magic"}, "threshold must"),
        ({"window": 0}, "window is"),
    ],
)
def test_bad_options_are_refused(options: dict[str, object], rule: str) -> None:
    with pytest.raises(ValueError, match=rule):
        Prbi(**options)  # type: ignore[arg-type]


def test_one_vehicle_is_refused() -> None:
    with pytest.raises(ValueError, match="at least 2"):
        Prbi().reset(1, np.random.default_rng(0))


def test_unknown_reading_is_refused() -> None:
    with pytest.raises(ValueError, match="once, halves, members, replace"):
        Reading(split="twice")  # type: ignore[arg-type]
