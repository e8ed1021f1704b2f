"""Strict average precision by hand and against a slow twin; identification rates and recovery."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cp_env.metrics.average_precision import ApMeter, average_precision, resampled_ap
from cp_env.types import Detections
from tests.reference import boxes as twin

NOTHING = np.zeros((0, 5))
Frame = tuple[np.ndarray, np.ndarray, np.ndarray]


def cars(*xs: float) -> np.ndarray:
    return np.array([[x, 0.0, 4.0, 2.0, 0.0] for x in xs]).reshape(-1, 5)


def found(*pairs: tuple[float, float]) -> Detections:
    """Cars at x with a score."""
    return Detections(cars(*(x for x, _ in pairs)), np.array([score for _, score in pairs], dtype=np.float64))


def drive(n_frames: int, seed: int) -> list[Frame]:
    """Frames in which some cars are seen well, some badly, some not at all, and some that are none."""
    rng = np.random.default_rng(seed)
    frames = []
    for _ in range(n_frames):
        n = int(rng.integers(0, 6))
        truth = rng.uniform([-9, -9, 4, 1.7, 0], [9, 9, 5, 2.1, 3], size=(n, 5))
        noise = rng.normal(0, [0.5, 0.3, 0.2, 0.1, 0.1], size=(2, n, 5))
        shown = np.concatenate([truth + noise[0], (truth + noise[1])[: n // 2]])[rng.random(n + n // 2) < 0.8]
        ghosts = rng.uniform([-9, -9, 4, 1.7, 0], [9, 9, 5, 2.1, 3], size=(int(rng.integers(0, 3)), 5))
        boxes = np.concatenate([shown, ghosts])
        frames.append((boxes, rng.integers(1, 20, size=len(boxes)) / 20, truth))  # with ties
    return frames


def ap(frames: list[Frame], iou: float) -> float:
    return average_precision([Detections(b, s) for b, s, _ in frames], [t for _, _, t in frames], iou)


def test_worked_by_hand() -> None:
    """Two frames, four cars. By score: hit, ghost, hit, ghost, hit; one car is never found.

    Precision at the hits is 1, 2/3, 3/5 with nothing better behind, each worth a quarter of the recall.
    """
    detections = [found((0, 0.9), (50, 0.8), (10, 0.7)), found((0.4, 0.3), (70, 0.5))]
    truths = [cars(0, 10), cars(0, 30)]
    assert average_precision(detections, truths, 0.5) == pytest.approx((1 + 2 / 3 + 3 / 5) / 4)


def test_interpolation_takes_the_best_precision_behind() -> None:
    """By score: ghost, hit, hit. Precision 1/2 at the first hit is lifted to the 2/3 of the second."""
    detections, truths = [found((50, 0.9), (0, 0.8), (10, 0.7))], [cars(0, 10)]
    assert average_precision(detections, truths, 0.5) == pytest.approx(2 / 3)


def test_a_frame_without_detections_counts() -> None:
    assert average_precision([found((0, 0.9)), found()], [cars(0), cars(0)], 0.5) == 0.5


def test_a_frame_without_truth_counts() -> None:
    assert average_precision([found((0, 0.5)), found((0, 0.9))], [cars(0), NOTHING], 0.5) == 0.5


def test_a_truth_is_taken_once() -> None:
    """The second guess at a car is a ghost; before the next car is found, it costs precision."""
    detections, truths = [found((0, 0.9), (0.1, 0.8), (10, 0.7))], [cars(0, 10)]
    assert average_precision(detections, truths, 0.5) == pytest.approx((1 + 2 / 3) / 2)


def test_a_detection_takes_the_best_of_what_is_left() -> None:
    """Both detections overlap the car at 0 most; the second still has the car at 1 (IoU 3.4/4.6 > 0.5)."""
    assert average_precision([found((0.0, 0.9), (0.4, 0.8))], [cars(0, 1)], 0.5) == 1
    assert average_precision([found((0.0, 0.9), (0.4, 0.8))], [cars(0, 1)], 0.75) == 0.5


def test_scores_are_pooled_over_frames() -> None:
    """A confident ghost in one frame stands before the hits of every other."""
    truths = [cars(0), cars(0)]
    assert average_precision([found((0, 0.9), (50, 0.2)), found((0, 0.8))], truths, 0.5) == 1
    assert average_precision([found((0, 0.7), (50, 0.9)), found((0, 0.8))], truths, 0.5) == pytest.approx(2 / 3)


def test_iou_equal_to_the_threshold_is_a_hit() -> None:
    """Half a length on: 2 m of 6 m shared."""
    assert average_precision([found((2, 0.9))], [cars(0)], 4 / 12 - 1e-12) == 1
    assert average_precision([found((2, 0.9))], [cars(0)], 4 / 12 + 1e-12) == 0
    assert average_precision([found((0, 0.9))], [cars(0)], 1.0) == 1


def test_nothing_to_find() -> None:
    assert average_precision([], [], 0.5) == average_precision([found()], [NOTHING], 0.5) == ApMeter().value(0.5) == 1
    assert average_precision([found((0, 0.1))], [NOTHING], 0.5) == 0


def test_equal_scores_are_one_point() -> None:
    """Hit and ghost of one score: no order of the rows may decide, so both are in."""
    for pair in ([(0, 0.5), (50, 0.5)], [(50, 0.5), (0, 0.5)]):
        assert average_precision([found(*pair)], [cars(0)], 0.5) == 0.5


@pytest.mark.parametrize("iou", [0.3, 0.5, 0.7])
@pytest.mark.parametrize("seed", range(6))
def test_agrees_with_the_slow_twin(seed: int, iou: float) -> None:
    frames = drive(8, seed)
    value = ap(frames, iou)
    assert value == pytest.approx(twin.average_precision(frames, iou), abs=1e-12)
    assert ap(frames, 0.3) > 0.2  # there is something to measure


@pytest.mark.parametrize("seed", range(12))
def test_laws_of_ap(seed: int) -> None:
    frames = drive(4, seed)
    values = [ap(frames, iou) for iou in (0.3, 0.5, 0.9)]
    assert all(0 <= value <= 1 for value in values)
    assert values == [ap(frames, iou) for iou in (0.3, 0.5, 0.9)]  # the second call says the same
    halved = [(b, s / 2, t) for b, s, t in frames[::-1]]  # neither the order of frames nor the scale of scores matters
    assert ap(halved, 0.5) == pytest.approx(values[1])
    perfect = [(t, np.ones(len(t)), t) for _, _, t in frames]
    assert ap(perfect, 0.9) == 1
    with_ghost = [*frames, (cars(50), np.array([1.0]), NOTHING)]
    assert ap(with_ghost, 0.5) < values[1]
    with_miss = [*frames, (NOTHING, np.zeros(0), cars(50))]
    assert ap(with_miss, 0.5) < values[1]


def test_inputs_stay_as_they_are() -> None:
    detections, truth = found((0, 0.2), (10, 0.9)), cars(0, 10)
    for array in (detections.boxes, detections.scores, truth):
        array.flags.writeable = False
    meter = ApMeter()
    meter.add(detections, truth)
    assert meter.value(0.5) == meter.value(0.5) == 1


def test_a_meter_keeps_no_hold_of_what_it_was_shown() -> None:
    detections, truth = found((0, 0.2), (10, 0.9)), cars(0, 30)
    meter = ApMeter()
    meter.add(detections, truth)
    before = meter.value(0.5)
    detections.scores[:] = detections.scores[::-1].copy()
    truth[:] = 99
    assert meter.value(0.5) == before == 0.25


def test_merging_is_adding() -> None:
    frames = drive(9, 3)
    whole, left, right = ApMeter([0.5, 0.7]), ApMeter([0.5, 0.7]), ApMeter([0.5, 0.7])
    for k, (boxes, scores, truth) in enumerate(frames):
        for meter in (whole, left if k < 4 else right):
            meter.add(Detections(boxes, scores), truth)
    apart = left.value(0.5), right.value(0.5)
    both = left.merge(right)
    assert (both.n_frames, both.n_truth) == (9, sum(len(t) for _, _, t in frames))
    assert [both.value(iou) for iou in (0.5, 0.7)] == [whole.value(iou) for iou in (0.5, 0.7)]
    assert whole.value(0.5) == pytest.approx(ap(frames, 0.5))
    assert (left.value(0.5), right.value(0.5)) == apart  # neither was changed
    assert left.merge(ApMeter([0.5, 0.7])).value(0.5) == apart[0]


def test_resampling_scenes_is_pooling_their_frames() -> None:
    scenes = [drive(5, seed) for seed in range(4)]
    meters = [ApMeter([0.5]) for _ in scenes]
    for meter, frames in zip(meters, scenes, strict=True):
        for boxes, scores, truth in frames:
            meter.add(Detections(boxes, scores), truth)
    statistic = resampled_ap(meters, 0.5)
    for rows in ([0, 1, 2, 3], [2], [0, 0, 3, 3], [1, 2, 2, 2]):
        pooled = [frame for row in rows for frame in scenes[row]]
        assert statistic(np.array(rows)) == pytest.approx(ap(pooled, 0.5))
    assert resampled_ap([], 0.5)(np.zeros(0, dtype=int)) == 1


def test_bad_input_is_refused() -> None:
    meter = ApMeter([0.5])
    with pytest.raises(ValueError, match=r"\(0, 1\]; got 0"):
        ApMeter([0.0])
    with pytest.raises(ValueError, match="got 1 frames of detections and 2 of truth"):
        average_precision([found()], [NOTHING, NOTHING], 0.5)
    with pytest.raises(ValueError, match="finite"):
        meter.add(found((math.nan, 0.5)), NOTHING)
    with pytest.raises(ValueError, match="NaN"):
        meter.add(found((0, math.nan)), NOTHING)
    with pytest.raises(ValueError, match=r"counts at IoU \(0.5,\); got 0.7"):
        meter.value(0.7)
    with pytest.raises(ValueError, match="do not merge"):
        meter.merge(ApMeter([0.7]))
    assert (meter.n_frames, meter.n_truth) == (0, 0)  # what was refused was not counted
