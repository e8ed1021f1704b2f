"""Figures of merit: average precision under two protocols, identification rates and recovery of a defence.

Both protocols pool the detections of all frames, overlap is rotated IoU in bird's-eye view, the truth is whatever is
handed in, seen or hidden, and AP is the area under the interpolated precision-recall curve at all points. In each frame
and at each IoU threshold by itself, detections choose a truth, best score first; a detection that
gets one with an IoU of at least the threshold is a true positive, one that gets none is a false positive.

    strict        (the default) every frame and every detection counts: truth in a frame without detections is missed,
                  detections in a frame without truth are false. A detection takes the truth it overlaps most among
                  those not yet taken.
    coperception  as the public coperception code counts, for figures that are compared with those published: only
                  detections with a score above 0.7, after non-maximum suppression at IoU 0.01; a frame without any of
                  them, or without truth, is dropped (what was missed there never counts); a detection whose best truth
                  is taken is false, though another might be free. If every frame was dropped, AP is 0.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from cp_env.geometry.boxes import nms, pairwise_iou
from cp_env.types import Detections


@dataclass(frozen=True)
class Rules:
    """Where the protocols differ. The defaults are strict."""

    above: float = -np.inf  # scores up to here do not count
    nms: float = 1.0  # detections that overlap a better one by more do not count
    drops_frames: bool = False  # frames without detections or without truth
    second_choice: bool = True  # a detection whose best truth is taken may take another
    of_nothing: float = 1.0  # AP of neither detections nor truth


RULES = {
    "strict": Rules(),
    "coperception": Rules(above=0.7, nms=0.01, drops_frames=True, second_choice=False, of_nothing=0.0),
}


def rules(protocol: str) -> Rules:
    """The rules of that name. ValueError for a name that is not known."""
    if protocol not in RULES:
        raise ValueError(f"unknown AP protocol {protocol!r}: choose one of {', '.join(RULES)}")
    return RULES[protocol]


def average_precision(
    detections: Sequence[Detections], truths: Sequence[ArrayLike], iou: float, protocol: str = "strict"
) -> float:
    """AP over frames, in [0, 1]: `detections[t]` against the boxes `truths[t]` [L_t, 5].

    Without any truth the strict one is 1 if there is no detection either, else 0.

    Raises:
        ValueError: the sequences differ in length; boxes are malformed; a score is NaN; `iou` not in (0, 1]; an unknown
            protocol.
    """
    if len(detections) != len(truths):
        raise ValueError(f"one truth a frame: got {len(detections)} frames of detections and {len(truths)} of truth")
    meter = ApMeter([iou], protocol)
    for found, truth in zip(detections, truths, strict=True):
        meter.add(found, truth)
    return meter.value(iou)


class ApMeter:
    """AP as frames come in. Frames are matched once; `value` pools what was matched and may be asked at any time."""

    def __init__(self, thresholds: Iterable[float] = (0.5, 0.7), protocol: str = "strict") -> None:
        self.rules, self.protocol = rules(protocol), protocol
        self.thresholds = tuple(float(iou) for iou in thresholds)
        for iou in self.thresholds:
            if not 0 < iou <= 1:
                raise ValueError(f"an IoU threshold lies in (0, 1]; got {iou}")
        self.n_frames = 0  # that count
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
        order = self._counted(detections.boxes, scores)
        if self.rules.drops_frames and not (len(order) and overlap.shape[1]):
            return
        overlap = overlap[order]
        self._scores.append(scores[order])
        self._hits.append(np.stack([assign(overlap, iou, self.rules.second_choice) >= 0 for iou in self.thresholds]))
        self.n_truth += overlap.shape[1]
        self.n_frames += 1

    def _counted(self, boxes: ArrayLike, scores: Float[np.ndarray, " L"]) -> Int[np.ndarray, " K"]:
        """Rows of the detections that count, best score first."""
        sure = np.flatnonzero(scores > self.rules.above)
        if self.rules.nms < 1:
            return sure[nms(np.asarray(boxes)[sure], scores[sure], self.rules.nms)]
        return sure[np.argsort(-scores[sure], kind="stable")]

    def value(self, iou: float) -> float:
        """AP at one of the thresholds, over all frames so far."""
        return resampled_ap([self], iou)(np.zeros(1, dtype=np.intp))

    def merge(self, other: ApMeter) -> ApMeter:
        """A new meter that has counted the frames of both."""
        if (self.thresholds, self.protocol) != (other.thresholds, other.protocol):
            raise ValueError(
                f"meters of different thresholds or protocols do not merge: {self.thresholds}, {self.protocol} and "
                f"{other.thresholds}, {other.protocol}"
            )
        both = ApMeter(self.thresholds, self.protocol)
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

    Precision falls from one true positive to the next, so the curve's ceiling rests on the places of true positives
    alone. What each meter adds at these is counted once; a resample weighs the counts. Meters of one protocol only.
    """
    of_nothing = max((meter.rules.of_nothing for meter in meters), default=Rules().of_nothing)
    parts = [meter.matched(iou) for meter in meters]
    scores = np.concatenate([score for score, _ in parts]) if parts else np.zeros(0)
    order = np.argsort(-scores, kind="stable")
    hits = np.concatenate([hit for _, hit in parts])[order] if parts else np.zeros(0, dtype=bool)
    owner = np.repeat(np.arange(len(parts)), [len(score) for score, _ in parts])[order]
    scores = scores[order]
    ends = np.flatnonzero(np.append(np.diff(scores) != 0, True)[: len(scores)])  # of equal scores the last
    ends = ends[np.diff(np.cumsum(hits)[ends], prepend=0) > 0]
    found, right = np.empty((2, len(parts), len(ends)))  # by meter, down to each of these scores
    for meter in range(len(parts)):
        mine = owner == meter
        found[meter], right[meter] = (
            np.searchsorted(np.flatnonzero(rows), ends, side="right") for rows in (mine, mine & hits)
        )
    n_truth = np.array([meter.n_truth for meter in meters], dtype=np.intp)
    n_found = np.array([len(score) for score, _ in parts], dtype=np.intp)

    def statistic(rows: Int[np.ndarray, " R"]) -> float:
        times = np.bincount(rows, minlength=len(n_truth)).astype(np.float64)
        total = int(times @ n_truth)
        if total == 0:
            return 0.0 if times @ n_found else of_nothing
        return _area(times @ right, times @ found, total)

    return statistic


def assign(overlap: Float[np.ndarray, "L M"], iou: float, second_choice: bool = True) -> Int[np.ndarray, " L"]:
    """The truth (column) that each detection (rows, best score first) gets, -1 if none.

    Each gets the one it overlaps most, of those that are free or, without `second_choice`, of all: then it gets none if
    that one is taken.
    """
    taken = np.full(len(overlap), -1)
    free = overlap.copy()
    for row in np.flatnonzero((overlap >= iou).any(axis=1)):
        best = int((free if second_choice else overlap)[row].argmax())
        if free[row, best] >= iou:
            taken[row] = best
            free[:, best] = -1.0
    return taken


def _area(right: Float[np.ndarray, " T"], found: Float[np.ndarray, " T"], n_truth: int) -> float:
    """Area under the interpolated precision-recall curve, from cumulative counts at descending scores."""
    precision = right / np.maximum(found, 1)
    ceiling = np.maximum.accumulate(precision[::-1])[::-1]  # the best precision at this recall or a higher one
    return float((np.diff(right, prepend=0) * ceiling).sum() / n_truth)
