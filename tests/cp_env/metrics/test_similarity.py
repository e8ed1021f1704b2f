"""Similarity of two views: matching, Jaccard similarity (Eq. 5), the ego's motion, agreement of score maps."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cp_env.geometry.boxes import pairwise_iou
from cp_env.metrics.similarity import agreement, jaccard, jaccard_many, match, view_similarity, view_similarity_many
from cp_env.types import Detections, View
from tests.reference import boxes as twin

NOTHING = np.zeros((0, 5))


def cars(*centres: tuple[float, float]) -> np.ndarray:
    return np.array([[x, y, 4.0, 2.0, 0.0] for x, y in centres]).reshape(-1, 5)


def crowd(n: int, seed: int, spread: float = 3.0) -> np.ndarray:
    """Boxes of one size on top of each other, so that many pairs pass a low threshold."""
    rng = np.random.default_rng(seed)
    return rng.uniform([-spread, -spread, 4.0, 1.8, -0.3], [spread, spread, 5.0, 2.2, 0.3], size=(n, 5))


def view(
    boxes: np.ndarray, frame: int = 0, origin: tuple[float, float] = (0.0, 0.0), score_map: np.ndarray | None = None
) -> View:
    seen = Detections(boxes, np.linspace(1, 0.5, len(boxes)))
    shown = np.zeros((64, 64)) if score_map is None else score_map
    return View(frozenset({0}), frame, np.array(origin, dtype=np.float64), seen, seen, shown)


def test_jaccard_worked_by_hand() -> None:
    a = cars((0, 0), (10, 0), (20, 0))
    b = cars((0.5, 0), (20, 9), (10, 0), (30, 0))  # IoU 3.5/4.5, none, 1, none
    assert jaccard(a, b) == 2 / (3 + 4 - 2)
    assert jaccard(a, b, iou=0.8) == 1 / (3 + 4 - 1)
    assert match(a, b).tolist() == [[0, 0], [1, 2]]


def test_iou_must_exceed_the_threshold() -> None:
    """A car half a width to the side shares a third of the union: 4 of 12."""
    assert jaccard(cars((0, 0)), cars((0, 1)), iou=0.33) == 1
    assert jaccard(cars((0, 0)), cars((0, 1)), iou=1 / 3 + 1e-12) == 0


def test_empty_sets() -> None:
    assert jaccard(NOTHING, NOTHING) == 1
    assert jaccard(NOTHING, cars((0, 0))) == jaccard(cars((0, 0)), NOTHING) == 0
    assert match(NOTHING, cars((0, 0))).shape == (0, 2)
    assert jaccard_many([], []).shape == (0,)
    assert jaccard([], []) == 1


def test_one_to_one_though_two_are_near() -> None:
    """Two guesses at one car match it once; taking the better guess first would leave the other car alone."""
    assert jaccard(cars((0, 0), (0.2, 0)), cars((0, 0))) == 1 / 2
    a, b = cars((0, 0), (0.8, 0)), cars((0.6, 0), (2.0, 0))  # IoU: (0,0) .74, (0,1) .33, (1,0) .90, (1,1) .54
    assert match(a, b).tolist() == [[0, 0], [1, 1]]


@pytest.mark.parametrize("threshold", [0.1, 0.3, 0.5])
@pytest.mark.parametrize("seed", range(25))
def test_matching_is_the_best_of_all(seed: int, threshold: float) -> None:
    """Against all assignments of small crowds: as many pairs as possible, then the largest summed IoU."""
    rng = np.random.default_rng(seed)
    a, b = crowd(int(rng.integers(1, 6)), seed, 1.5), crowd(int(rng.integers(1, 7)), seed + 1000, 1.5)
    table = pairwise_iou(a, b)
    pairs = match(a, b, threshold)
    assert len(set(pairs[:, 0].tolist())) == len(set(pairs[:, 1].tolist())) == len(pairs)
    value = table[pairs[:, 0], pairs[:, 1]]
    assert (value > threshold).all()
    most, largest = twin.best_matching(table, threshold)
    assert (len(pairs), pytest.approx(largest)) == (most, value.sum())


@pytest.mark.parametrize("seed", range(15))
def test_laws_of_the_jaccard(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = (crowd(int(rng.integers(0, 20)), seed + k) for k in range(2))
    values = [jaccard(a, b, iou) for iou in (0.0, 0.3, 0.6, 0.9)]
    assert all(0 <= value <= 1 for value in values)
    assert values == sorted(values, reverse=True)  # a stricter match never makes two sets more similar
    assert values == [jaccard(b, a, iou) for iou in (0.0, 0.3, 0.6, 0.9)]
    assert jaccard(rng.permutation(a), rng.permutation(b), 0.3) == values[1]
    assert jaccard(a, a, 0.9) == 1


def test_many_at_once_are_as_each_alone() -> None:
    sizes = [(5, 9), (0, 0), (12, 12), (0, 3), (1, 30), (8, 0)]
    a = [crowd(n, seed) for seed, (n, _) in enumerate(sizes)]
    b = [crowd(n, seed + 99) for seed, (_, n) in enumerate(sizes)]
    alone = [jaccard(p, q, 0.3) for p, q in zip(a, b, strict=True)]
    assert jaccard_many(a, b, 0.3).tolist() == alone
    assert len(set(alone)) > 3


def test_the_egos_motion_is_taken_out() -> None:
    """Parked cars stay where they are in the world; the ego drives 5 m east and 2 m north."""
    world = np.array([[10.0, 4.0], [-6.0, 12.0], [20.0, -20.0]])
    older = view(cars(*(world - [0, 0]).tolist()), frame=3)
    newer = view(cars(*(world - [5, 2]).tolist()), frame=4, origin=(5.0, 2.0))
    assert view_similarity(older, newer) == view_similarity(newer, older) == 1
    assert jaccard(older.seen.boxes, newer.seen.boxes) == 0


def test_only_common_ground_is_compared() -> None:
    """The ego drives 10 m east. A car 30 m behind falls out of range and one 30 m ahead comes in: no disagreement."""
    older = view(cars((-30, 0), (5, 0)), frame=0)
    newer = view(cars((-5, 0), (30, 0)), frame=1, origin=(10.0, 0.0))
    assert view_similarity(older, newer) == view_similarity(newer, older) == 1
    ghost = view(cars((-5, 0), (30, 0), (21, 8)), frame=1, origin=(10.0, 0.0))  # 31 m from the older origin: in range
    assert view_similarity(older, ghost) == 1 / 2
    assert view_similarity(older, view(cars((30, 0)), frame=1, origin=(10.0, 0.0))) == 0


def test_without_motion_nothing_is_left_out() -> None:
    rim = cars((32.5, 0), (0, 0))  # a decoder may place a centre a little beyond the range
    assert view_similarity(view(rim), view(cars((0, 0)))) == 1 / 2


def test_views_without_common_ground_have_similarity_zero() -> None:
    here, there = view(NOTHING, 0), view(NOTHING, 50, origin=(64.0, 0.0))
    assert view_similarity(here, there) == 0
    assert agreement(here, there) == 0
    nearly = view(NOTHING, 50, origin=(63.0, 0.0))
    assert view_similarity(here, nearly) == 1


def test_many_pairs_of_views_are_as_each_alone() -> None:
    views = [view(crowd(n, n, 20.0), frame=n, origin=(0.7 * n, -0.3 * n)) for n in range(12)]
    pairs = [(views[i], views[j]) for i in range(12) for j in range(0, 12, 3)]
    assert view_similarity_many(pairs).tolist() == [view_similarity(a, b) for a, b in pairs]


def test_only_what_is_seen_counts() -> None:
    a, b = view(cars((0, 0))), view(cars((0, 0)))
    faint = View(b.group, 0, b.origin, Detections(crowd(9, 0), np.full(9, 0.06)), b.seen, b.score_map)
    assert view_similarity(a, faint) == 1


def test_agreement_worked_by_hand() -> None:
    """Four cells: p = (1, 0, 0, 0), q = (.5, .5, 0, 0). Vehicle: sums 2, shared .5; background: sums 6, shared 2.5."""
    p, q = np.array([[1.0, 0.0], [0.0, 0.0]]), np.array([[0.5, 0.5], [0.0, 0.0]])
    expected = (0.5 / 4 + 2.5 / 36) / (2 / 4 + 6 / 36)
    assert agreement(view(NOTHING, score_map=p), view(NOTHING, score_map=q)) == pytest.approx(expected, rel=1e-12)


def test_agreement_of_certain_maps() -> None:
    p = np.zeros((8, 8))
    p[2, 3] = 1
    same, empty, full = (view(NOTHING, score_map=m) for m in (p, 0 * p, 0 * p + 1))
    assert agreement(same, same) == pytest.approx(0.5)  # the most there is
    assert agreement(empty, empty) == pytest.approx(0.5)  # an absent class is left out
    assert agreement(full, empty) == 0
    assert agreement(same, empty) < 0.02


@given(st.integers(0, 10_000))
def test_agreement_is_symmetric_bounded_and_as_the_slow_twin(seed: int) -> None:
    p, q = np.random.default_rng(seed).random((2, 6, 6)) ** 4
    a, b = view(NOTHING, score_map=p), view(NOTHING, frame=1, score_map=q)
    assert agreement(a, b) == agreement(b, a) == pytest.approx(twin.agreement(p, q), rel=1e-12)
    assert 0 <= agreement(a, b) <= 0.5
    assert agreement(a, b) <= max(agreement(a, a), agreement(b, b)) + 1e-12


@pytest.mark.parametrize(("east", "north"), [(3, 0), (0, 3), (-5, 2), (4, -7), (2.4, -0.4)])
def test_agreement_moves_the_older_map(east: float, north: float) -> None:
    """A world drawn on 1 m cells, seen from two places: the maps agree on their common ground, and only when moved."""
    world = np.random.default_rng(0).random((100, 100)) ** 6
    right, up = round(east), round(north)
    older = view(NOTHING, 0, (0.0, 0.0), world[18:82, 18:82])
    newer = view(NOTHING, 1, (east, north), world[18 + up : 82 + up, 18 + right : 82 + right])
    common = world[18 + max(up, 0) : 82 + min(up, 0), 18 + max(right, 0) : 82 + min(right, 0)]
    expected = twin.agreement(common, common)
    assert agreement(older, newer) == agreement(newer, older) == pytest.approx(expected, rel=1e-9)
    assert agreement(older, view(NOTHING, 0, (0.0, 0.0), newer.score_map)) < 0.8 * expected


def test_the_cell_follows_from_the_range() -> None:
    """On a map of 4 cells over ±4 m, 2 m are one cell."""
    p = np.arange(16.0).reshape(4, 4) / 16
    moved = np.roll(p, -1, axis=1)
    older, newer = view(NOTHING, 0, (0.0, 0.0), p), view(NOTHING, 1, (2.0, 0.0), moved)
    assert agreement(older, newer, extent=4.0) == pytest.approx(twin.agreement(p[:, 1:], p[:, 1:]))


def test_views_stay_as_they_are() -> None:
    a = view(cars((0, 0), (5, 5)), 0, score_map=np.full((4, 4), 0.3))
    b = view(cars((1, 0), (5, 5)), 1, origin=(1.0, 0.0), score_map=np.full((4, 4), 0.4))
    for v in (a, b):
        for array in (v.origin, v.seen.boxes, v.seen.scores, v.score_map):
            array.flags.writeable = False
    assert view_similarity(a, b) == view_similarity(a, b)
    assert agreement(a, b) == agreement(a, b)


def test_bad_input_is_refused() -> None:
    with pytest.raises(ValueError, match="finite"):
        jaccard(cars((0, math.nan)), NOTHING)
    with pytest.raises(ValueError, match=r"\[0, 1\); got 1"):
        match(NOTHING, NOTHING, 1.0)
    with pytest.raises(ValueError, match="2 and 1 sets"):
        jaccard_many([NOTHING, NOTHING], [NOTHING])
    with pytest.raises(ValueError, match=r"\(64, 64\) and \(8, 8\)"):
        agreement(view(NOTHING), view(NOTHING, score_map=np.zeros((8, 8))))
