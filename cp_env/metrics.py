"""Figures of merit: strict average precision of a detector, identification rates and recovery of a defence.

The strict protocol: detections of all frames are pooled; overlap is rotated IoU in bird's-eye view; a frame without
detections (its truth is missed) or without truth (its detections are false) counts like any other; the truth is
whatever is handed in, seen or hidden. In each frame and at each IoU threshold by itself, every detection, best score
first, takes the truth it overlaps most among those not yet taken, if that IoU is at least the threshold: a true
positive; else it is a false one. AP is the area under the interpolated precision-recall curve at all points.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from cp_env.boxes import pairwise_iou
from cp_env.types import Detections


def average_precision(detections: Sequence[Detections], truths: Sequence[ArrayLike], iou: float) -> float:
    """AP over frames, in [0, 1]: `detections[t]` against the boxes `truths[t]` [L_t, 5].

    Without any truth it is 1 if there is no detection either, else 0.

    Raises:
        ValueError: the sequences differ in length; boxes are malformed; a score is NaN; `iou` not in (0, 1].
    """
    if len(detections) != len(truths):
        raise ValueError(f"one truth a frame: got {len(detections)} frames of detections and {len(truths)} of truth")
    meter = ApMeter([iou])
    for found, truth in zip(detections, truths, strict=True):
        meter.add(found, truth)
    return meter.value(iou)


class ApMeter:
    """AP as frames come in. Frames are matched once; `value` pools what was matched and may be asked at any time."""

    def __init__(self, thresholds: Iterable[float] = (0.5, 0.7)) -> None:
        self.thresholds = tuple(float(iou) for iou in thresholds)
        for iou in self.thresholds:
            if not 0 < iou <= 1:
                raise ValueError(f"an IoU threshold lies in (0, 1]; got {iou}")
        self.n_frames = 0
        self.n_truth = 0
        self._scores: list[Float[np.ndarray, " L"]] = []
        self._hits: list[Bool[np.ndarray, "I L"]] = []  # true positive at each threshold

    def add(self, detections: Detections, truth: ArrayLike) -> None:
        """Count one frame against the boxes `truth` [L, 5], both in one grid frame; neither is changed nor kept."""
        scores = np.array(detections.scores, dtype=np.float64)
        if np.isnan(scores).any():
            raise ValueError("scores must not be NaN: drop such detections first")
        overlap = pairwise_iou(detections.boxes, truth)
        if len(scores) != len(overlap):
            raise ValueError(f"one score a box: got {len(scores)} scores for {len(overlap)} boxes")
        order = np.argsort(-scores, kind="stable")
        overlap = overlap[order]
        self._scores.append(scores[order])
        self._hits.append(np.stack([_take(overlap, iou) for iou in self.thresholds]))
        self.n_truth += overlap.shape[1]
        self.n_frames += 1

    def value(self, iou: float) -> float:
        """AP at one of the thresholds, over all frames so far."""
        return resampled_ap([self], iou)(np.zeros(1, dtype=np.intp))

    def merge(self, other: ApMeter) -> ApMeter:
        """A new meter that has counted the frames of both."""
        if self.thresholds != other.thresholds:
            raise ValueError(f"meters of different thresholds do not merge: {self.thresholds} and {other.thresholds}")
        both = ApMeter(self.thresholds)
        both.n_frames = self.n_frames + other.n_frames
        both.n_truth = self.n_truth + other.n_truth
        both._scores = self._scores + other._scores
        both._hits = self._hits + other._hits
        return both

    def matched(self, iou: float) -> tuple[Float[np.ndarray, " D"], Bool[np.ndarray, " D"]]:
        """Score of every detection so far, and whether it was a true positive at threshold `iou`."""
        if iou not in self.thresholds:
            raise ValueError(f"this meter counts at IoU {self.thresholds}; got {iou}: name it when making the meter")
        row = self.thresholds.index(iou)
        if not self._scores:
            return np.zeros(0), np.zeros(0, dtype=bool)
        return np.concatenate(self._scores), np.concatenate([hits[row] for hits in self._hits])


def resampled_ap(meters: Sequence[ApMeter], iou: float) -> Callable[[Int[np.ndarray, " R"]], float]:
    """A bootstrap's statistic: given row numbers of `meters` (scenes), AP of those pooled, repeats counted again.

    Detections are sorted once, so that each resample costs a few cumulative sums.
    """
    parts = [meter.matched(iou) for meter in meters]
    scores = np.concatenate([score for score, _ in parts]) if parts else np.zeros(0)
    order = np.argsort(-scores, kind="stable")
    hits = np.concatenate([hit for _, hit in parts])[order] if parts else np.zeros(0, dtype=bool)
    owner = np.repeat(np.arange(len(parts)), [len(score) for score, _ in parts])[order]
    scores = scores[order]
    last_of_equals = np.append(np.diff(scores) != 0, True)[: len(scores)]
    n_truth = np.array([meter.n_truth for meter in meters], dtype=np.intp)

    def statistic(rows: Int[np.ndarray, " R"]) -> float:
        times = np.bincount(rows, minlength=len(n_truth))
        weight = times[owner]
        found = np.cumsum(weight)[last_of_equals]
        right = np.cumsum(weight * hits)[last_of_equals]
        return _area(right, found, int(times @ n_truth))

    return statistic


def id_rate(suspects: Collection[int], liars: Collection[int]) -> float:
    """Share of the liars that are accused; 1 if nobody lies."""
    return len(set(suspects) & set(liars)) / len(set(liars)) if liars else 1.0


def mc_rate(suspects: Collection[int], liars: Collection[int], n: int) -> float:
    """Share of the benign among vehicles 0 … n-1 that are accused; 0 if nobody is benign."""
    benign = set(range(n)) - set(liars)
    return len(set(suspects) & benign) / len(benign) if benign else 0.0


def recovery(ap: float, attacked: float, clean: float) -> float:
    """Share of the AP lost to an attack that a defence restores: (ap - attacked) / (clean - attacked).

    Below 0 where the defence does more harm than the attack, above 1 where it beats the clean value. If the attack cost
    nothing (clean <= attacked) there is nothing to restore: 1 if `ap` is at least the clean value, else 0.
    """
    loss = clean - attacked
    if loss <= 0:
        return 1.0 if ap >= clean else 0.0
    return (ap - attacked) / loss


def _take(overlap: Float[np.ndarray, "L M"], iou: float) -> Bool[np.ndarray, " L"]:
    """Which detections (rows, best score first) get a truth (columns): each the free one it overlaps most."""
    hits = np.zeros(len(overlap), dtype=bool)
    free = overlap.copy()
    for row in np.flatnonzero((overlap >= iou).any(axis=1)):
        best = int(free[row].argmax())
        if free[row, best] >= iou:
            hits[row] = True
            free[:, best] = -1.0
    return hits


def _area(right: Int[np.ndarray, " D"], found: Int[np.ndarray, " D"], n_truth: int) -> float:
    """Area under the interpolated precision-recall curve, from cumulative counts at descending scores."""
    if n_truth == 0:
        return 0.0 if len(found) and found[-1] else 1.0
    precision = right / np.maximum(found, 1)
    ceiling = np.maximum.accumulate(precision[::-1])[::-1]  # the best precision at this recall or a higher one
    return float((np.diff(right, prepend=0) * ceiling).sum() / n_truth)
