"""Two AP protocols on the same detections: by hand, and against implementations that are not ours."""

from __future__ import annotations

import contextlib
import io
import math
from collections.abc import Sequence

import numpy as np
import pytest

from cp_env.evaluation.plan.records import PooledApMeter
from cp_env.geometry.planar import corners
from cp_env.metrics.average_precision import RULES, ApMeter, average_precision, resampled_ap
from cp_env.types import Detections
from tests.cp_env.metrics.test_average_precision import NOTHING, cars, drive, found

BOTH = tuple(RULES)
Frame = tuple[np.ndarray, np.ndarray, np.ndarray]


def both(detections: list[Detections], truths: list[np.ndarray], iou: float = 0.5) -> tuple[float, float]:
    """AP under each protocol."""
    strict, theirs = (average_precision(detections, truths, iou, protocol) for protocol in BOTH)
    return strict, theirs


def test_the_protocols_have_names() -> None:
    assert BOTH == ("strict", "coperception")
    with pytest.raises(ValueError, match=r"unknown AP protocol 'voc': choose one of strict, coperception"):
        ApMeter(protocol="voc")


def test_they_agree_where_nothing_sets_them_apart() -> None:
    """Sure detections that do not overlap, in frames that hold something: hit, ghost, hit of three cars."""
    detections, truths = [found((0, 0.95), (50, 0.9), (10, 0.8))], [cars(0, 10, 30)]
    assert both(detections, truths) == pytest.approx(((1 + 2 / 3) / 3,) * 2)


def test_only_sure_detections_count() -> None:
    """The second car is found with a score of 0.7, the third with 0.5: coperception asks for more than 0.7."""
    strict, theirs = both([found((0, 0.9), (10, 0.7), (20, 0.5))], [cars(0, 10, 20)])
    assert (strict, theirs) == pytest.approx((1, 1 / 3))


def test_unsure_ghosts_are_forgiven() -> None:
    """A ghost of score 0.6 stands before a hit of 0.5 in the strict count; both are not there in the other."""
    strict, theirs = both([found((0, 0.9), (50, 0.6), (10, 0.5))], [cars(0, 10)])
    assert (strict, theirs) == pytest.approx(((1 + 2 / 3) / 2, 1 / 2))


def test_overlapping_detections_are_suppressed() -> None:
    """The second guess at the first car is a ghost, unless it is suppressed; it overlaps the better one (IoU 3/5)."""
    strict, theirs = both([found((0, 0.95), (1, 0.9), (10, 0.8))], [cars(0, 10)])
    assert (strict, theirs) == pytest.approx(((1 + 2 / 3) / 2, 1))


def test_suppression_can_cost_a_neighbour() -> None:
    """Two cars bumper to bumper, guessed 10 cm too long each: their boxes overlap by 10 cm of 8.1 m, IoU 0.012."""
    truth = np.array([[0, 0, 4, 2, 0], [4, 0, 4, 2, 0]], dtype=np.float64)
    boxes = truth + np.array([0, 0, 0.1, 0, 0])
    strict, theirs = both([Detections(boxes, np.array([0.9, 0.8]))], [truth])
    assert (strict, theirs) == pytest.approx((1, 0.5))


def test_what_was_missed_in_a_dropped_frame_never_counts() -> None:
    """Frame by frame: one of one found; nothing (sure) of three found; a ghost where nothing is."""
    detections = [found((0, 0.95)), found((50, 0.3)), found((0, 0.9))]
    truths = [cars(0), cars(0, 10, 20), NOTHING]
    strict, theirs = both(detections, truths)
    assert (strict, theirs) == pytest.approx((1 / 4, 1))


def test_a_detection_does_not_fall_back_on_its_second_choice() -> None:
    """Two trucks side by side, two boxes that both overlap the first one most: the strict count gives the second box
    the second truck (IoU 0.5), coperception calls it false. The boxes themselves overlap little enough to stay."""
    truth = np.array([[0, 0, 10, 3.0, 0], [0, 1.5, 10, 3.0, 0]])
    boxes = np.array([[0, -0.7, 10, 1.5, 0], [0, 0.85, 10, 1.6, 0]])
    meter = ApMeter([0.3], "coperception")
    meter.add(Detections(boxes, np.array([0.95, 0.9])), truth)
    assert meter.matched(0.3)[1].tolist() == [True, True]
    shifted = boxes - np.array([0, 0.15, 0, 0, 0])  # now the second box overlaps the first truck more
    sharp = [ApMeter([0.3], protocol) for protocol in BOTH]
    for one in sharp:
        one.add(Detections(shifted, np.array([0.95, 0.9])), truth)
    assert [one.matched(0.3)[1].tolist() for one in sharp] == [[True, True], [True, False]]


def test_without_anything_to_count() -> None:
    assert both([found()], [NOTHING]) == (1, 0)
    assert both([found((0, 0.5))], [NOTHING]) == (0, 0)
    assert both([found((0, 0.9))], [NOTHING]) == (0, 0)
    assert both([], []) == (1, 0)


def test_the_meter_says_how_many_frames_count() -> None:
    meter = ApMeter(protocol="coperception")
    for detections, truth in ((found((0, 0.9)), cars(0)), (found(), cars(0)), (found((0, 0.9)), NOTHING)):
        meter.add(detections, truth)
    assert (meter.n_frames, meter.n_truth) == (1, 1)


def test_meters_of_two_protocols_do_not_mix() -> None:
    with pytest.raises(ValueError, match="do not merge"):
        ApMeter(protocol="strict").merge(ApMeter(protocol="coperception"))
    with pytest.raises(ValueError, match="do not merge"):
        PooledApMeter.pool([ApMeter(protocol="strict"), ApMeter(protocol="coperception")])


@pytest.mark.parametrize("seed", range(4))
def test_scenes_pool_and_resample(seed: int) -> None:
    scenes = [spread(drive(5, 10 * seed + part)) for part in range(3)]
    meters = []
    for frames in scenes:
        meter = ApMeter([0.5], "coperception")
        for boxes, scores, truth in frames:
            meter.add(Detections(boxes, scores), truth)
        meters.append(meter)
    for rows in ([0, 1, 2], [1], [0, 0, 2]):
        pooled = [frame for row in rows for frame in scenes[row]]
        assert resampled_ap(meters, 0.5)(np.array(rows)) == pytest.approx(theirs(pooled, 0.5))
    assert PooledApMeter.pool(meters).value(0.5) == pytest.approx(
        theirs([frame for frames in scenes for frame in frames], 0.5)
    )


def spread(frames: list[Frame]) -> list[Frame]:
    """The same frames with scores of which no two are equal (who sorts breaks ties) and most are sure."""
    ends = np.cumsum([len(boxes) for boxes, _, _ in frames])
    scores = 0.6 + 0.4 * np.random.default_rng(len(frames)).permutation(ends[-1]) / ends[-1]
    return [(boxes, part, truth) for (boxes, _, truth), part in zip(frames, np.split(scores, ends[:-1]), strict=True)]


def theirs(frames: list[Frame], iou: float) -> float:
    return average_precision([Detections(b, s) for b, s, _ in frames], [t for _, _, t in frames], iou, "coperception")


@pytest.mark.parametrize("iou", [0.5, 0.7])
@pytest.mark.parametrize("seed", range(6))
def test_coperception_agrees_with_a_twin_of_shapely_polygons(seed: int, iou: float) -> None:
    """Rotated boxes as polygons of shapely, and the protocol once more, a detection at a time."""
    import shapely

    def overlap(a: np.ndarray, b: np.ndarray) -> float:
        one, other = (shapely.Polygon(corners(np.asarray(box, dtype=np.float64))) for box in (a, b))
        return one.intersection(other).area / one.union(other).area

    frames = spread(drive(12, seed))
    pooled: list[tuple[float, bool]] = []
    n_truth = 0
    for boxes, scores, truth in frames:
        kept: list[int] = []
        for row in sorted(np.flatnonzero(scores > 0.7), key=lambda r: -scores[r]):
            if all(overlap(boxes[row], boxes[other]) <= 0.01 for other in kept):
                kept.append(row)
        if not kept or not len(truth):
            continue
        n_truth += len(truth)
        taken: set[int] = set()
        for row in kept:
            table = [overlap(boxes[row], box) for box in truth]
            best = int(np.argmax(table))
            pooled.append((scores[row], table[best] >= iou and best not in taken))
            if table[best] >= iou:
                taken.add(best)
    assert theirs(frames, iou) == pytest.approx(area(pooled, n_truth), abs=1e-9)


def area(pooled: Sequence[tuple[float, bool]], n_truth: int) -> float:
    """Mean, over the truth, of the best precision at that recall or beyond; 0 for what is never found."""
    hits = [hit for _, hit in sorted(pooled, key=lambda pair: -pair[0])]
    precision = [sum(hits[: end + 1]) / (end + 1) for end in range(len(hits))]
    return math.fsum(max(precision[row:]) for row, hit in enumerate(hits) if hit) / n_truth if n_truth else 0.0


@pytest.mark.parametrize("iou", [0.5, 0.7])
@pytest.mark.parametrize("seed", range(6))
def test_strict_agrees_with_coco(seed: int, iou: float) -> None:
    """pycocotools on boxes along the axes: asked for its precision at every recall there is, its mean is the area."""
    frames = [(upright(boxes), scores, upright(truth)) for boxes, scores, truth in spread(drive(12, seed))]
    ours = average_precision([Detections(b, s) for b, s, _ in frames], [t for _, _, t in frames], iou)
    assert ours == pytest.approx(coco_ap(frames, iou), abs=1e-9)


def upright(boxes: np.ndarray) -> np.ndarray:
    return np.concatenate([boxes[:, :4], np.zeros_like(boxes[:, 4:])], axis=1)


def coco_ap(frames: list[Frame], iou: float) -> float:
    from pycocotools.coco import COCO
    from pycocotools.cocoeval import COCOeval

    def rectangle(box: np.ndarray) -> list[float]:
        x, y, length, width, _ = (float(number) for number in box)
        return [x - length / 2, y - width / 2, length, width]

    truth = [
        {"image_id": t, "category_id": 1, "bbox": rectangle(box), "area": float(box[2] * box[3]), "iscrowd": 0}
        for t, (_, _, boxes) in enumerate(frames)
        for box in boxes
    ]
    found = [
        {"image_id": t, "category_id": 1, "bbox": rectangle(box), "score": float(score)}
        for t, (boxes, scores, _) in enumerate(frames)
        for box, score in zip(boxes, scores, strict=True)
    ]
    with contextlib.redirect_stdout(io.StringIO()):
        coco = COCO()
        coco.dataset = {
            "info": {},
            "images": [{"id": t} for t in range(len(frames))],
            "categories": [{"id": 1}],
            "annotations": [{"id": i + 1, **one} for i, one in enumerate(truth)],
        }
        coco.createIndex()
        evaluation = COCOeval(coco, coco.loadRes(found), "bbox")
        evaluation.params.iouThrs = np.array([iou])
        evaluation.params.recThrs = np.arange(1, len(truth) + 1) / len(truth) - 1e-9  # every recall that can be reached
        evaluation.params.areaRng, evaluation.params.areaRngLbl = [[0, 1e5]], ["all"]
        evaluation.params.maxDets = [1000]
        evaluation.evaluate()
        evaluation.accumulate()
    return float(evaluation.eval["precision"].mean())
