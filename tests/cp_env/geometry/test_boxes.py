"""Exact overlap of oriented boxes, and non-maximum suppression."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from cp_env.geometry.boxes import nms, nms_batch, overlaps, pairwise_iou, rotated_iou
from cp_env.geometry.planar import corners
from tests.reference import boxes as twin

CAR = [3.0, -2.0, 4.5, 1.9, 0.4]


def random_boxes(n: int, seed: int, spread: float = 5.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    low, high = [-spread, -spread, 1.0, 0.5, -7.0], [spread, spread, 6.0, 3.0, 7.0]
    return rng.uniform(low, high, size=(n, 5))


def shapely_iou(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    first, second = shapely.polygons(corners(a)), shapely.polygons(corners(b))
    shared = shapely.area(shapely.intersection(first, second))
    return shared / (shapely.area(first) + shapely.area(second) - shared)


def moved(boxes: np.ndarray, x: float, y: float, yaw: float) -> np.ndarray:
    """The boxes after a rigid motion of the plane."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    out = boxes.copy()
    out[..., 0] = x + cos * boxes[..., 0] - sin * boxes[..., 1]
    out[..., 1] = y + sin * boxes[..., 0] + cos * boxes[..., 1]
    out[..., 4] += yaw
    return out


# A unit of area is a square metre; every value below is worked by hand.
@pytest.mark.parametrize(
    ("a", "b", "expected"),
    [
        ([0, 0, 4, 2, 0], [0, 0, 4, 2, 0], 1.0),  # identical
        ([0, 0, 4, 2, 0], [2, 0, 4, 2, 0], 4 / 12),  # half a length on
        ([0, 0, 4, 2, 0], [0, 1, 4, 2, 0], 4 / 12),  # half a width to the side
        ([0, 0, 4, 2, 0], [4, 0, 4, 2, 0], 0.0),  # touching along an edge
        ([0, 0, 4, 2, 0], [4, 2, 4, 2, 0], 0.0),  # touching at a corner
        ([0, 0, 4, 2, 0], [0, 0, 4, 2, math.pi], 1.0),  # front for back
        ([0, 0, 4, 2, 0], [0, 0, 2, 4, math.pi / 2], 1.0),  # the same rectangle said otherwise
        ([0, 0, 4, 2, 0], [0, 0, 4, 2, math.pi / 2], 4 / 12),  # a cross
        ([0, 0, 4, 4, 0], [0, 0, 2, 1, 0.3], 2 / 16),  # contained, b in a
        ([0, 0, 2, 1, 0.3], [0, 0, 4, 4, 0], 2 / 16),  # contained, a in b
        (
            [0, 0, 2, 2, 0],
            [0, 0, 2, 2, math.pi / 4],
            (8 * (math.sqrt(2) - 1)) / (8 - 8 * (math.sqrt(2) - 1)),
        ),  # octagon
        ([0, 0, 2, 2, 0], [1, 1, math.sqrt(8), 1e-9, -math.pi / 4], 0.0),  # a sliver along the diagonal
        ([0, 0, 4, 0, 0], [0, 0, 4, 0, 0], 0.0),  # no area
        ([0, 0, 4, 0, 0], [0, 0, 4, 2, 0], 0.0),
        ([0, 0, 0, 0, 0], [0, 0, 0, 0, 0], 0.0),
        ([0, 0, 4, 2, 0], [0, 0, 4 + 1e-12, 2, 1e-12], 1.0),  # a hair from identical
    ],
)
def test_overlap_worked_by_hand(a: list[float], b: list[float], expected: float) -> None:
    assert float(rotated_iou(a, b)) == pytest.approx(expected, abs=1e-9)
    assert float(rotated_iou(b, a)) == pytest.approx(expected, abs=1e-9)


def test_agrees_with_shapely_on_random_pairs() -> None:
    a, b = random_boxes(4000, seed=0, spread=2.5), random_boxes(4000, seed=1, spread=2.5)
    ours = rotated_iou(a, b)
    assert (ours > 0.01).mean() > 0.5  # the pairs are worth comparing
    np.testing.assert_allclose(ours, shapely_iou(a, b), rtol=0, atol=1e-12)


TURN = st.sampled_from([0.0, math.pi / 2, math.pi, -math.pi / 2, math.pi / 4, 2 * math.pi, 1e-9, 1e-16, 0.3])
STEP = st.sampled_from([0.0, 1.0, 2.0, 4.0, -2.25, 1e-9, 1e-15, 1e-300, -1e-12])
SIZE = st.sampled_from([0.0, 1e-9, 0.95, 1.9, 2.0, 4.0, 4.5, 4.5 + 1e-12])
NEAR_DEGENERATE = st.tuples(STEP, STEP, SIZE, SIZE, TURN)


@given(NEAR_DEGENERATE, NEAR_DEGENERATE, st.sampled_from([0.0, 0.7, math.pi / 2, 3.0]))
def test_near_degenerate_pairs_agree_with_shapely(a: tuple[float, ...], b: tuple[float, ...], yaw: float) -> None:
    """Shared edges, shared corners, slivers and hair's breadths, square to the axes and turned."""
    pair = moved(np.array([a, b]), 1.5, -0.5, yaw)
    ours = float(rotated_iou(pair[0], pair[1]))
    assert 0 <= ours <= 1
    polygons = shapely.polygons(corners(pair))
    sizes = pair[:, 2] * pair[:, 3]
    if min(sizes) > 1e-6:  # shapely rejects flat polygons
        shared = shapely.area(shapely.intersection(*polygons))
        assert ours == pytest.approx(shared / (sizes.sum() - shared), abs=1e-7)
    else:
        assert ours <= min(sizes) / max(sizes.max(), 1e-300) + 1e-12


@pytest.mark.parametrize("seed", range(3))
def test_agrees_with_the_slow_twin(seed: int) -> None:
    a, b = random_boxes(20, seed), random_boxes(25, seed + 100)
    expected = [[twin.iou(p, q) for q in b] for p in a]
    np.testing.assert_allclose(pairwise_iou(a, b), expected, rtol=0, atol=1e-12)


@given(st.integers(0, 10_000), st.floats(-1000, 1000), st.floats(-1000, 1000), st.floats(-10, 10))
def test_a_rigid_motion_of_both_changes_nothing(seed: int, x: float, y: float, yaw: float) -> None:
    a, b = random_boxes(30, seed, spread=2.0), random_boxes(30, seed + 1, spread=2.0)
    np.testing.assert_allclose(
        rotated_iou(moved(a, x, y, yaw), moved(b, x, y, yaw)), rotated_iou(a, b), rtol=0, atol=1e-9
    )


@given(st.integers(0, 10_000), st.floats(0.01, 100))
def test_scale_front_and_order_do_not_matter(seed: int, scale: float) -> None:
    a, b = random_boxes(30, seed, spread=2.0), random_boxes(30, seed + 1, spread=2.0)
    plain = rotated_iou(a, b)
    np.testing.assert_allclose(rotated_iou(b, a), plain, rtol=0, atol=1e-12)
    metres = [scale, scale, scale, scale, 1.0]
    np.testing.assert_allclose(rotated_iou(a * metres, b * metres), plain, rtol=0, atol=1e-12)
    turned = a[:, [0, 1, 3, 2, 4]] + [0, 0, 0, 0, math.pi / 2]
    np.testing.assert_allclose(rotated_iou(turned, b), plain, rtol=0, atol=1e-12)


def test_a_box_overlaps_itself_exactly() -> None:
    boxes = random_boxes(1000, seed=2)
    np.testing.assert_array_equal(rotated_iou(boxes, boxes), np.ones(1000))


def test_moving_apart_never_adds_overlap() -> None:
    steps = np.linspace(0, 8, 400)
    away = np.array(CAR) + np.stack([steps * 0.6, steps * 0.8, 0 * steps, 0 * steps, 0 * steps], axis=1)
    value = rotated_iou(CAR, away)
    assert value[0] == 1 and value[-1] == 0
    assert (np.diff(value) <= 1e-12).all()


def test_leading_axes_broadcast() -> None:
    a, b = random_boxes(6, 0).reshape(2, 3, 1, 5), random_boxes(4, 1)
    assert rotated_iou(a, b).shape == (2, 3, 4)
    np.testing.assert_array_equal(rotated_iou(a, b).reshape(6, 4), pairwise_iou(a.reshape(6, 5), b))


def test_many_pairs_are_computed_like_few() -> None:
    a, b = random_boxes(1500, 0, 2.0), random_boxes(1500, 1, 2.0)
    alone = [float(rotated_iou(a[k], b[k])) for k in range(0, 1500, 20)]
    np.testing.assert_array_equal(rotated_iou(a, b)[::20], alone)


def test_far_boxes_are_left_out_and_no_others() -> None:
    """The filter on distance must not lose a pair: long boxes end to end, corner to corner."""
    a = np.array([[0, 0, 12, 2.5, 0.1]])
    b = random_boxes(3000, seed=3, spread=12.0)
    np.testing.assert_allclose(pairwise_iou(a, b)[0], rotated_iou(a, b), rtol=0, atol=0)


def test_single_precision_is_computed_in_double() -> None:
    a, b = random_boxes(50, 0, 2.0).astype(np.float32), random_boxes(50, 1, 2.0).astype(np.float32)
    np.testing.assert_array_equal(rotated_iou(a, b), rotated_iou(a.astype(np.float64), b.astype(np.float64)))


def test_no_boxes() -> None:
    assert pairwise_iou(np.zeros((0, 5)), random_boxes(3, 0)).shape == (0, 3)
    assert pairwise_iou([], []).shape == (0, 0)
    assert nms([], [], 0.5).tolist() == []
    assert [len(part) for part in overlaps([], [])] == [0] * 4
    assert [len(part) for part in overlaps([[], [CAR]], [[CAR], []])] == [0] * 4


def test_overlaps_of_many_sets_are_those_of_each() -> None:
    sizes = [(3, 7), (0, 4), (12, 1), (20, 20), (5, 0)]
    a = [random_boxes(n, seed, 4.0) for seed, (n, _) in enumerate(sizes)]
    b = [random_boxes(n, seed + 50, 4.0) for seed, (_, n) in enumerate(sizes)]
    view, i, j, value = overlaps(a, b, above=0.1)
    got = list(zip(view.tolist(), i.tolist(), j.tolist(), strict=True))
    tables = [pairwise_iou(p, q) for p, q in zip(a, b, strict=True)]
    assert got == [(v, int(p), int(q)) for v, table in enumerate(tables) for p, q in np.argwhere(table > 0.1)]
    np.testing.assert_array_equal(value, [tables[v][p, q] for v, p, q in got])


def test_suppression_worked_by_hand() -> None:
    """Three cars in a row, each a third of the union with the next: the middle one is best, then only it stays."""
    boxes = [[0, 0, 4, 2, 0], [2, 0, 4, 2, 0], [4, 0, 4, 2, 0]]
    assert nms(boxes, [0.5, 0.9, 0.4], 0.3).tolist() == [1]
    assert nms(boxes, [0.9, 0.5, 0.4], 0.3).tolist() == [0, 2]  # the first silences the second, which silences nobody
    assert nms(boxes, [0.5, 0.9, 0.4], 0.34).tolist() == [1, 0, 2]
    assert nms([[0, 0, 4, 2, 0], [2, 0, 4, 2, 0]], [0.5, 0.5], 4 / 12).tolist() == [0, 1]  # not above: stays


@pytest.mark.parametrize("threshold", [0.0, 0.1, 0.5, 1.0])
@pytest.mark.parametrize("seed", range(4))
def test_suppression_agrees_with_the_slow_twin(seed: int, threshold: float) -> None:
    boxes = random_boxes(40, seed, spread=6.0)
    scores = np.random.default_rng(seed).integers(0, 12, size=40) / 12  # with ties
    kept = nms(boxes, scores, threshold)
    assert kept.tolist() == twin.nms(boxes, scores, threshold)
    assert (np.diff(scores[kept]) <= 0).all()


def test_what_stays_does_not_overlap_and_what_goes_does() -> None:
    boxes, scores = random_boxes(200, 7, 15.0), np.random.default_rng(7).random(200)
    kept = nms(boxes, scores, 0.2)
    among = pairwise_iou(boxes[kept], boxes[kept])
    assert among[~np.eye(len(kept), dtype=bool)].max() <= 0.2
    for row in set(range(200)) - set(kept.tolist()):
        rivals = kept[scores[kept] > scores[row]]
        assert pairwise_iou(boxes[[row]], boxes[rivals]).max() > 0.2


def test_each_view_is_suppressed_by_itself() -> None:
    """Views of differing sizes, an empty one among them, rows in any order: each as if alone."""
    rng = np.random.default_rng(5)
    boxes, scores = random_boxes(120, 5, 6.0), rng.random(120)
    views = rng.choice([0, 1, 3, 4], p=[0.5, 0.1, 0.3, 0.1], size=120)
    kept = nms_batch(boxes, scores, views, 0.1)
    expected: list[int] = []
    for view in range(5):
        rows = np.flatnonzero(views == view)
        expected += rows[nms(boxes[rows], scores[rows], 0.1)].tolist()
    assert kept.tolist() == expected


def test_the_order_of_rows_does_not_matter_to_suppression() -> None:
    boxes, scores = random_boxes(60, 8, 6.0), np.random.default_rng(8).random(60)
    shuffle = np.random.default_rng(9).permutation(60)
    np.testing.assert_array_equal(shuffle[nms(boxes[shuffle], scores[shuffle], 0.15)], nms(boxes, scores, 0.15))


def test_inputs_stay_as_they_are() -> None:
    boxes, scores = random_boxes(30, 0), np.random.default_rng(0).random(30)
    views = np.repeat([1, 0], 15)
    for array in (boxes, scores, views):
        array.flags.writeable = False
    before = boxes.copy()
    first = nms_batch(boxes, scores, views, 0.1)
    np.testing.assert_array_equal(nms_batch(boxes, scores, views, 0.1), first)
    pairwise_iou(boxes, boxes)
    np.testing.assert_array_equal(boxes, before)


@pytest.mark.parametrize(
    ("boxes", "rule"),
    [
        ([[0, 0, 4, 2, math.nan]], "finite"),
        ([[math.inf, 0, 4, 2, 0]], "finite"),
        ([[0, 0, -4, 2, 0]], "negative"),
        ([[0, 0, 4, 2]], r"shape must be \[L, 5\]; got \(1, 4\)"),
        ([0, 0, 4, 2, 0], r"shape must be \[L, 5\]"),
    ],
)
def test_malformed_boxes_are_refused(boxes: list[list[float]], rule: str) -> None:
    with pytest.raises(ValueError, match=rule):
        pairwise_iou(boxes, [CAR])
    with pytest.raises(ValueError, match=rule):
        overlaps([[CAR]], [boxes])
    with pytest.raises(ValueError, match=rule):
        nms(boxes, [1.0], 0.5)


def test_other_bad_input_is_refused() -> None:
    with pytest.raises(ValueError, match="finite"):
        rotated_iou(CAR, [0, 0, 4, 2, math.nan])
    with pytest.raises(ValueError, match="NaN"):
        nms([CAR], [math.nan], 0.5)
    with pytest.raises(ValueError, match=r"\[0, 1\]; got 1.5"):
        nms([CAR], [0.5], 1.5)
    with pytest.raises(ValueError, match="1 boxes need as many scores"):
        nms([CAR], [0.5, 0.6], 0.5)
    with pytest.raises(ValueError, match="count from 0; got -1"):
        nms_batch([CAR], [0.5], [-1], 0.5)
    with pytest.raises(ValueError, match="got 2 and 1 sets"):
        overlaps([[CAR], [CAR]], [[CAR]])
