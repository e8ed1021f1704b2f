"""Critical recall and critical AP: only vehicles that matter for the ego's driving count.

A vehicle is critical within 10 m in the ego's corridor, or with a time to collision below 4 s (`Surroundings`). Others
are "don't care": missed they are no false negatives, and a detection of one is neither right nor wrong. A detection of
nothing is false only where a standing vehicle in its place would be critical: our reading, since a ghost behind the ego
is as indifferent to its driving as a car there.

After the criticality metrics of 2512.15181 and 2603.28029; the limits are this project's choice.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from cp_env.geometry.boxes import pairwise_iou
from cp_env.metrics.average_precision import ApMeter, assign
from cp_env.metrics.surroundings import Surroundings
from cp_env.types import Detections

MATCH = 0.5
"""IoU at which a vehicle counts as found."""


def found(boxes: Float[np.ndarray, "B 5"], truth: Float[np.ndarray, "L 5"]) -> Bool[np.ndarray, " L"]:
    """Whether each true vehicle overlaps one of the boxes with an IoU of at least 0.5."""
    if not len(boxes):
        return np.zeros(len(truth), dtype=bool)
    return np.asarray((pairwise_iou(boxes, truth) >= MATCH).any(axis=0))


def critical_recall(boxes: Float[np.ndarray, "B 5"], around: Surroundings) -> tuple[int, int]:
    """How many critical vehicles the boxes find, and how many there are; a rate pools both over frames."""
    mine = around.boxes[around.critical]
    return int(found(boxes, mine).sum()), len(mine)


class CriticalApMeter(ApMeter):
    """AP@0.5 over critical vehicles; strict in all else. Frames come in by `add_critical`."""

    def __init__(self) -> None:
        super().__init__([MATCH])

    def add_critical(self, detections: Detections, around: Surroundings) -> None:
        """Count one frame.

        Args:
            detections: the output's, in the ego's grid frame.
            around: the true traffic of that frame.
        """
        order = np.argsort(-detections.scores, kind="stable")
        boxes, scores = detections.boxes[order], np.asarray(detections.scores, dtype=np.float64)[order]
        taken = assign(pairwise_iou(boxes, around.boxes), MATCH)
        hit = (taken >= 0) & np.append(around.critical, False)[taken]
        false = np.zeros(len(boxes), dtype=bool)
        if (taken < 0).any():
            false[taken < 0] = around.standing(boxes[taken < 0]).critical
        counted = hit | false
        self._scores.append(scores[counted])
        self._hits.append(hit[None, counted])
        self.n_truth += int(around.critical.sum())
        self.n_frames += 1
