"""The world without scenes: what a view tells, who lies when, and the numbers kept of many episodes."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import defenders
from defenders import EgoOnly, NoDefence, Prbi, Query, QueryError, Verdict
from defenders.protocol import Defender, Frame, Inspection
from defenders.simulation.statistics import members, play_many
from defenders.simulation.verifier import ErrorRates, Measured, exact
from defenders.simulation.world import PerfectWorld, Terms, always, every, play, turning

LIARS = frozenset({1, 4})


class Survey(NoDefence):
    """Looks at every group of three and keeps how like the honest view of the first frame they are."""

    groups = tuple(map(frozenset, itertools.combinations(range(5), 3)))

    def inspect(self, frame: Frame) -> Inspection:
        views = yield Query(self.groups)
        if frame.index == 0:
            self.reference = frame.seen
        self.seen = [frame.similarity(view, self.reference) for view in views]
        return Verdict(range(5))


def survey(world: PerfectWorld, frames: int) -> np.ndarray:
    """Similarities of all groups of three in the frames after an honest one, shape (frames, 10)."""
    watcher = Survey()
    watcher.reset(5, np.random.default_rng(0))
    world.judge(watcher, lying=False)
    rows = []
    for _ in range(frames):
        world.judge(watcher)
        rows.append(watcher.seen)
    return np.array(rows)


def test_without_errors_exactly_the_groups_with_a_liar_look_wrong() -> None:
    rows = survey(PerfectWorld(5, LIARS), 3)
    assert (rows == [float(group.isdisjoint(LIARS)) for group in Survey.groups]).all()


def test_error_rates_by_size_and_number_of_liars() -> None:
    """Of the groups of three one is honest, six hold one liar and three hold two."""
    rates = ErrorRates(false_fail={(3, 0): 0.1, (5, 0): 0.0}, false_pass=lambda size, liars: [0, 0.3, 0.05][liars])
    rows = survey(PerfectWorld(5, LIARS, likeness=rates, rng=np.random.default_rng(1)), 600)
    liars = np.array([len(group & LIARS) for group in Survey.groups])
    assert set(np.unique(rows)) == {0.0, 1.0}
    for count, expected, tolerance in ((0, 0.9, 0.04), (1, 0.3, 0.03), (2, 0.05, 0.02)):
        assert rows[:, liars == count].mean() == pytest.approx(expected, abs=tolerance)


def test_similarities_are_drawn_from_what_was_measured() -> None:
    samples = {(3, 0): [0.7, 0.9], (3, 1): [0.1, 0.2, 0.3], (3, 2): [0.0], (5, 0): [0.8], (5, 2): [0.05]}
    rows = survey(PerfectWorld(5, LIARS, likeness=Measured(samples)), 300)
    for column, group in enumerate(Survey.groups):
        values = samples[3, len(group & LIARS)]
        assert set(rows[:, column]) == set(values)
        assert rows[:, column].mean() == pytest.approx(np.mean(values), abs=0.02)


def test_a_lie_is_a_bad_reference_and_one_that_passes_a_good_one() -> None:
    shows = {frozenset({0, 1}): 0.9, frozenset({0, 4}): 0.1}
    world = PerfectWorld(5, LIARS, likeness=lambda group, lying, rng: shows.get(group, 0.0 if lying else 0.6))
    world.show(True)
    passed, failed, honest, later = (world.look(group) for group in ({0, 1}, {0, 4}, {0, 2}, {2, 3}))
    assert world.similarity(passed, later) == world.similarity(later, passed) == 0.6
    assert world.similarity(failed, later) == world.similarity(later, failed) == 0.1
    assert world.similarity(honest, later) == 0.6
    assert world.agreement(failed, later) == 0.05


def test_a_group_asked_twice_in_a_frame_is_looked_at_once() -> None:
    world = PerfectWorld(5, LIARS, likeness=ErrorRates(0.5, 0.5))
    world.show(True)
    assert world.look({0, 1}) == world.look(frozenset({1, 0}))
    before = world.look(range(5))
    world.show(True)
    assert world.look(range(5)) != before


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
def test_who_lies_when(schedule: object, expected: list[int]) -> None:
    terms = Terms(n_vehicles=5, n_liars=2, schedule=schedule, grace_frames=0, max_frames=6)  # type: ignore[arg-type]
    episode = terms.play(NoDefence(), 0)
    assert [len(ruling.lying) for ruling in episode.rulings] == expected
    assert all(ruling.lying <= episode.liars for ruling in episode.rulings)


def test_grace_frames_are_honest_and_not_recorded() -> None:
    episode = Terms(n_vehicles=5, n_liars=2, grace_frames=2, schedule=every(3), max_frames=4).play(NoDefence(), 0)
    assert [len(ruling.lying) for ruling in episode.rulings] == [0, 2, 0, 0]  # frames 2, 3, 4, 5


def test_an_episode_may_go_on_after_convergence() -> None:
    terms = Terms(n_vehicles=5, n_liars=1, max_frames=9, until_converged=False)
    episode = terms.play(Prbi(), 0)
    assert len(episode.rulings) == 9 and episode.rulings[5].verdict.converged


def test_a_trusted_ego_never_lies_and_nobody_else_is_spared() -> None:
    tally = play_many(EgoOnly(), Terms(n_vehicles=4, n_liars=3, honest={0}, max_frames=1), episodes=5, seed=0)
    assert (members(tally.liars, 4) == [False, True, True, True]).all()
    drawn = play_many(EgoOnly(), Terms(n_vehicles=4, n_liars=1, max_frames=1), episodes=400, seed=0)
    assert members(drawn.liars, 4).mean(axis=0) == pytest.approx(0.25, abs=0.08)


@settings(max_examples=10)
@given(st.sampled_from(("prbi", "robosac", "pasac", "oracle")), st.integers(3, 8), st.integers(0, 2**32))
def test_any_episode_of_a_batch_can_be_played_alone(name: str, n: int, seed: int) -> None:
    terms = Terms(n_vehicles=n, n_liars=n // 2, likeness=ErrorRates(0.2, 0.2), max_frames=6, honest={0})
    tally = play_many(defenders.make(name), terms, episodes=3, seed=seed)
    for i in range(3):
        episode = terms.play(defenders.make(name), np.random.SeedSequence([seed, i]))
        played = len(episode.rulings)
        assert tally.frames[i] == played and tally.converged[i] == episode.converged
        assert tally.verifications[i].tolist() == episode.verifications + [-1] * (len(tally.verifications[i]) - played)
        sets = [[*np.flatnonzero(row)] for row in members(tally.accused[i, :played], n)]
        assert sets == [sorted(ruling.verdict.suspects) for ruling in episode.rulings]
        assert (tally.solved[i], *np.flatnonzero(tally.convicted[i])) == (
            episode.suspects == episode.liars,
            *sorted(episode.suspects),
        )


class Scripted(NoDefence):
    """Accuses and fuses by the book, one page a frame, and pays as many looks at vehicle 0 as the frame's number."""

    accusations = ((), (1, 2), (2,), (1, 2))

    def inspect(self, frame: Frame) -> Inspection:
        yield Query([{0}] * frame.index)
        accused = frozenset(self.accusations[frame.index])
        return Verdict({0, 3}, accused)


def test_numbers_worked_by_hand() -> None:
    """Vehicle 3 of four lies from frame 2 on; 1 and 2 are innocent."""
    terms = Terms(n_vehicles=4, n_liars=1, honest={0, 1, 2}, schedule=every(1, start=2), grace_frames=0, max_frames=4)
    tally = play_many(Scripted(), terms, episodes=2, seed=0)
    assert tally.verifications.tolist() == [[0, 1, 2, 3]] * 2
    assert tally.first_abnormal.tolist() == [2, 2] and tally.first.tolist() == [2, 2]
    assert tally.all_verifications.tolist() == [0, 1, 2, 3] * 2
    assert tally.liars.tolist() == [8, 8] and tally.accused[0].tolist() == [0, 6, 4, 6]
    assert tally.convicted_since[0].tolist() == [-1, 3, 1, -1]
    assert tally.identified.tolist() == [0, 0] and tally.wronged == pytest.approx([2 / 3] * 2)
    assert tally.deceived[0].tolist() == [0, 0, 1, 1]
    assert not tally.solved.any() and not tally.converged.any()


def test_nobody_lying_has_no_first_abnormal_frame() -> None:
    tally = play_many(NoDefence(), Terms(n_vehicles=64, n_liars=0, max_frames=2), episodes=2, seed=0)
    assert tally.first_abnormal.tolist() == [-1, -1] and tally.first.size == 0
    assert np.isnan(tally.identified).all() and (tally.wronged == 0).all() and tally.solved.all()
    assert (tally.fused == np.uint64(2**64 - 1)).all()


def test_play_is_terms_in_short() -> None:
    assert play(Prbi(), 5, 2, 3) == Terms(n_vehicles=5, n_liars=2).play(Prbi(), 3)


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
        PerfectWorld(5, LIARS).judge(Nonsense(queries, verdict))


@pytest.mark.parametrize(
    "terms",
    [
        {"n_liars": 5},
        {"n_liars": -1},
        {"n_liars": 4, "honest": {0, 1}},
        {"honest": {5}},
        {"max_frames": 0},
        {"grace_frames": -1},
    ],
)
def test_terms_that_cannot_be_played_are_refused(terms: dict[str, object]) -> None:
    with pytest.raises(ValueError):
        Terms(**{"n_vehicles": 5, "n_liars": 2, **terms})  # type: ignore[arg-type]


def test_other_bad_doors() -> None:
    with pytest.raises(ValueError, match="probability"):
        ErrorRates(false_pass=1.5)
    with pytest.raises(ValueError, match="probability"):
        ErrorRates(false_fail={(1, 0): -0.1})
    with pytest.raises(ValueError, match=r"add \(3, 0\)"):
        survey(PerfectWorld(5, LIARS, likeness=ErrorRates(false_fail={(5, 0): 0.0})), 1)
    with pytest.raises(ValueError, match=r"\(1, 0\)"):
        Measured({(1, 0): []})
    with pytest.raises(ValueError, match="64"):
        play_many(NoDefence(), Terms(n_vehicles=65, n_liars=1), episodes=1, seed=0)
    with pytest.raises(ValueError, match="among"):
        PerfectWorld(3, frozenset({3}))
    with pytest.raises(ValueError, match="period"):
        every(0)
    with pytest.raises(ValueError, match="late"):
        turning(3, late=0)
    assert exact(frozenset({1}), frozenset(), np.random.default_rng(0)) == 1.0


def test_who_is_absent_is_in_no_view_and_lies_to_nobody() -> None:
    world = PerfectWorld(
        4, frozenset({2}), absent=lambda frame, liars: frozenset({2, 3}) if frame == 1 else frozenset()
    )
    frames = [world.show(lying=True) for _ in range(2)]
    assert [frame.present for frame in frames] == [{0, 1, 2, 3}, {0, 1}]
    assert world.lying == frozenset() and world.look({0, 2}) == world.look({0})
    assert frames[1].similarity(frames[1].seen, world.look({1})) == 1


@pytest.mark.parametrize("groups, fused", [([{2}], {0}), ([], {2})])
def test_a_group_or_a_verdict_of_nobody_present_is_an_error(groups: list[set[int]], fused: set[int]) -> None:
    class Lonely(Defender):
        def reset(self, n_vehicles: int, rng: np.random.Generator) -> None: ...

        def inspect(self, frame: Frame) -> Inspection:
            yield Query(groups)
            return Verdict(fused)

    world = PerfectWorld(3, frozenset(), absent=lambda frame, liars: frozenset({2}))
    with pytest.raises(QueryError, match=r"present in this frame are \[0, 1\]"):
        world.judge(Lonely())


def test_the_ego_is_always_there() -> None:
    with pytest.raises(ValueError, match="ego"):
        PerfectWorld(3, frozenset(), absent=lambda frame, liars: frozenset({0})).show(lying=False)
