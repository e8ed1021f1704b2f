"""The simulated world: similarity models, schedules of attacks, and statistics of many episodes."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from defenders import EgoOnly, NoDefence, Prbi, Query, QueryError, Verdict
from defenders.protocol import Defender, Frame, Inspection
from defenders.simulation.statistics import members, play_many
from defenders.simulation.verifier import ErrorRates, Measured, exact
from defenders.simulation.world import Scenario, SimulatedWorld, always, every, play, turning

ATTACKERS = frozenset({1, 4})


class Survey(NoDefence):
    """Verifies every group of three and keeps the similarities to the full view of the first frame."""

    groups = tuple(map(frozenset, itertools.combinations(range(5), 3)))

    def inspect(self, frame: Frame) -> Inspection:
        views = yield Query(self.groups)
        if frame.index == 0:
            self.reference = frame.seen
        self.seen = [frame.similarity(view, self.reference) for view in views]
        return Verdict(range(5))


def survey(world: SimulatedWorld, frames: int) -> np.ndarray:
    """Similarities of all groups of three in the frames after one without an attack, shape (frames, 10)."""
    watcher = Survey()
    watcher.reset(5, np.random.default_rng(0))
    world.judge(watcher, attack=False)
    rows = []
    for _ in range(frames):
        world.judge(watcher)
        rows.append(watcher.seen)
    return np.array(rows)


def test_without_errors_exactly_the_groups_with_an_attacker_fail() -> None:
    rows = survey(SimulatedWorld(5, ATTACKERS), 3)
    assert (rows == [float(group.isdisjoint(ATTACKERS)) for group in Survey.groups]).all()


def test_a_contaminated_reference_is_bad_unless_it_passes() -> None:
    shows = {frozenset({0, 1}): 0.9, frozenset({0, 4}): 0.1}
    world = SimulatedWorld(
        5, ATTACKERS, similarity_model=lambda group, active, rng: shows.get(group, 0.0 if active else 0.6)
    )
    world.show(True)
    passed, failed, benign, later = (world.view(group) for group in ({0, 1}, {0, 4}, {0, 2}, {2, 3}))
    assert world.similarity(passed, later) == world.similarity(later, passed) == 0.6
    assert world.similarity(failed, later) == world.similarity(later, failed) == 0.1
    assert world.similarity(benign, later) == 0.6
    assert world.agreement(failed, later) == 0.05


def test_a_group_queried_twice_in_a_frame_has_one_view() -> None:
    world = SimulatedWorld(5, ATTACKERS, similarity_model=ErrorRates(0.5, 0.5))
    world.show(True)
    assert world.view({0, 1}) == world.view(frozenset({1, 0}))
    before = world.view(range(5))
    world.show(True)
    assert world.view(range(5)) != before


@pytest.mark.parametrize(
    ("schedule", "expected"),
    [
        (always, [2, 2, 2, 2, 2, 2]),
        (every(3), [2, 0, 0, 2, 0, 0]),
        (every(2, start=3), [0, 0, 0, 2, 0, 2]),
        (turning(4), [1, 1, 1, 1, 2, 2]),
        (turning(2, late=2), [0, 0, 2, 2, 2, 2]),
    ],
)
def test_schedules(schedule: object, expected: list[int]) -> None:
    scenario = Scenario(n_vehicles=5, n_attackers=2, schedule=schedule, grace_frames=0, max_frames=6)  # type: ignore[arg-type]
    episode = scenario.play(NoDefence(), 0)
    assert [len(result.active) for result in episode.results] == expected
    assert all(result.active <= episode.attackers for result in episode.results)


def test_grace_frames_are_unattacked_and_not_recorded() -> None:
    episode = Scenario(n_vehicles=5, n_attackers=2, grace_frames=2, schedule=every(3), max_frames=4).play(
        NoDefence(), 0
    )
    assert [len(result.active) for result in episode.results] == [0, 2, 0, 0]  # frames 2, 3, 4, 5


def test_an_episode_may_go_on_after_convergence() -> None:
    scenario = Scenario(n_vehicles=5, n_attackers=1, max_frames=9, until_converged=False)
    episode = scenario.play(Prbi(), 0)
    assert len(episode.results) == 9 and episode.results[5].verdict.converged


def test_a_trusted_ego_never_attacks_and_any_other_vehicle_may() -> None:
    stats = play_many(EgoOnly(), Scenario(n_vehicles=4, n_attackers=3, benign={0}, max_frames=1), episodes=5, seed=0)
    assert (members(stats.attackers, 4) == [False, True, True, True]).all()
    drawn = play_many(EgoOnly(), Scenario(n_vehicles=4, n_attackers=1, max_frames=1), episodes=400, seed=0)
    assert members(drawn.attackers, 4).mean(axis=0) == pytest.approx(0.25, abs=0.08)


def test_an_episode_without_attackers_has_no_first_abnormal_frame() -> None:
    stats = play_many(NoDefence(), Scenario(n_vehicles=64, n_attackers=0, max_frames=2), episodes=2, seed=0)
    assert stats.first_abnormal.tolist() == [-1, -1] and stats.first.size == 0
    assert (
        np.isnan(stats.identified).all()
        and (stats.false_accusation_rate == 0).all()
        and stats.exact_identification.all()
    )
    assert (stats.fused == np.uint64(2**64 - 1)).all()


def test_play_is_a_scenario_in_short() -> None:
    assert play(Prbi(), 5, 2, 3) == Scenario(n_vehicles=5, n_attackers=2).play(Prbi(), 3)


class Nonsense(NoDefence):
    def __init__(self, queries: list[object], verdict: object) -> None:
        self.queries, self.verdict = queries, verdict

    def inspect(self, frame: Frame) -> Inspection:
        yield from (query for query in self.queries)  # type: ignore[misc]  # a list cannot be sent answers
        return self.verdict  # type: ignore[return-value]


@pytest.mark.parametrize(
    ("queries", "verdict", "complaint"),
    [
        ([Query([()])], Verdict({0}), "group"),
        ([Query([{5}])], Verdict({0}), "group"),
        ([Query([{0}])] * 65, Verdict({0}), "max_queries"),
        ([[{0}]], Verdict({0}), "must yield a Query"),
        ([], None, "must return a Verdict"),
        ([], Verdict(()), "must fuse"),
        ([], Verdict({0}, {5}), "must fuse"),
    ],
)
def test_nonsense_is_refused(queries: list[object], verdict: object, complaint: str) -> None:
    with pytest.raises(QueryError, match=complaint):
        SimulatedWorld(5, ATTACKERS).judge(Nonsense(queries, verdict))


@pytest.mark.parametrize(
    "scenario",
    [
        {"n_attackers": 5},
        {"n_attackers": -1},
        {"n_attackers": 4, "benign": {0, 1}},
        {"benign": {5}},
        {"max_frames": 0},
        {"grace_frames": -1},
    ],
)
def test_contradictory_scenarios_are_refused(scenario: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=next(iter(scenario))):
        Scenario(**{"n_vehicles": 5, "n_attackers": 2, **scenario})  # type: ignore[arg-type]


def test_other_bad_arguments() -> None:
    with pytest.raises(ValueError, match="probability"):
        ErrorRates(false_pass=1.5)
    with pytest.raises(ValueError, match="probability"):
        ErrorRates(false_fail={(1, 0): -0.1})
    with pytest.raises(ValueError, match=r"add \(3, 0\)"):
        survey(SimulatedWorld(5, ATTACKERS, similarity_model=ErrorRates(false_fail={(5, 0): 0.0})), 1)
    with pytest.raises(ValueError, match=r"\(1, 0\)"):
        Measured({(1, 0): []})
    with pytest.raises(ValueError, match="64"):
        play_many(NoDefence(), Scenario(n_vehicles=65, n_attackers=1), episodes=1, seed=0)
    with pytest.raises(ValueError, match="among"):
        SimulatedWorld(3, frozenset({3}))
    with pytest.raises(ValueError, match="period"):
        every(0)
    with pytest.raises(ValueError, match="late"):
        turning(3, late=0)
    assert exact(frozenset({1}), frozenset(), np.random.default_rng(0)) == 1.0


def test_an_absent_vehicle_is_in_no_view_and_never_active() -> None:
    world = SimulatedWorld(
        4, frozenset({2}), absent=lambda frame, attackers: frozenset({2, 3}) if frame == 1 else frozenset()
    )
    frames = [world.show(attack=True) for _ in range(2)]
    assert [frame.present for frame in frames] == [{0, 1, 2, 3}, {0, 1}]
    assert world.active == frozenset() and world.view({0, 2}) == world.view({0})
    assert frames[1].similarity(frames[1].seen, world.view({1})) == 1


@pytest.mark.parametrize(("groups", "fused"), [([{2}], {0}), ([], {2})])
def test_a_group_or_a_verdict_of_nobody_present_is_an_error(groups: list[set[int]], fused: set[int]) -> None:
    class Lonely(Defender):
        def reset(self, n_vehicles: int, rng: np.random.Generator) -> None: ...

        def inspect(self, frame: Frame) -> Inspection:
            yield Query(groups)
            return Verdict(fused)

    world = SimulatedWorld(3, frozenset(), absent=lambda frame, attackers: frozenset({2}))
    with pytest.raises(QueryError, match=r"present in this frame are \[0, 1\]"):
        world.judge(Lonely())


def test_the_ego_is_always_there() -> None:
    with pytest.raises(ValueError, match="ego"):
        SimulatedWorld(3, frozenset(), absent=lambda frame, attackers: frozenset({0})).show(attack=False)
