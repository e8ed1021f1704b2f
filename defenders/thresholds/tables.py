"""Similarity thresholds ε: one for every group, or one for each size of group.

A view of few vehicles resembles the reference less than a view of many, whether it is contaminated or not. So with one
ε a large contaminated group passes or a small uncontaminated one fails. How much they differ depends on the detector
and on how the ego fuses. So calibrated thresholds are measured for each detector, see `defenders.calibration`.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from pathlib import Path

from defenders.calibration.files import checked_thresholds
from defenders.calibration.lookup import DEFAULT, calibration_for

PREVIOUS_FRAME = "previous_frame"
"""The part of a calibration for groups that are compared with the frame before: PRBI's."""
EGO_ONLY = {score: f"ego_{score}" for score in ("agreement", "similarity")}
"""The parts for groups with the ego that are compared with the ego-only view: those of ROBOSAC and PASAC."""


class Thresholds:
    """ε for a group of a given size. A group larger than any calibrated one gets the threshold of the largest."""

    def __init__(self, epsilon: Mapping[int, float], part: str | None = None, path: Path | None = None) -> None:
        """Check the thresholds.

        Args:
            epsilon: ε by group size.
            part: the part of a calibration that takes their place when the detector is known; None: nothing does.
            path: the calibration file that was named; None: the one that is found.

        Raises:
            ValueError: sizes do not run from 1 without a gap, or an ε is not in [0, 1].
        """
        self.epsilon, self._part, self._path = checked_thresholds(epsilon), part, path

    def __call__(self, group: frozenset[int]) -> float:
        return self.epsilon[min(len(group), len(self.epsilon))]

    def of(self, fusion: str) -> Thresholds:
        """The thresholds for an ego with this fusion, see `calibration_for`; the same ones if they are not calibrated.

        Raises:
            ValueError: a calibration file that is broken.
        """
        made = copy.copy(self)
        if self._part is not None:
            made.epsilon = calibration_for(fusion, self._part, self._path).thresholds(self._part)
        return made


def open_thresholds(threshold: str | Mapping[int, float], epsilon: float, part: str = PREVIOUS_FRAME) -> Thresholds:
    """The thresholds that a defender is built with.

    Args:
        threshold: "paper": `epsilon` for every size; "calibrated": the calibration of the ego's detector, that which
            ships until a defender is configured; the path of a calibration file; or a mapping from size to ε.
        epsilon: ε of "paper".
        part: which part of a calibration.

    Raises:
        ValueError: another name, impossible thresholds, or a calibration file that is broken or lacks the part.
    """
    if isinstance(threshold, Mapping):
        return Thresholds({int(size): value for size, value in threshold.items()})
    if threshold == "paper":
        return Thresholds({1: epsilon})
    named = None if threshold == "calibrated" else Path(threshold)
    if named is not None and named.suffix != ".json":
        raise ValueError(
            'threshold must be "paper", "calibrated", the path of a calibration file (.json), or a mapping from group '
            f"size to ε, got {threshold!r}"
        )
    return Thresholds(calibration_for(DEFAULT, part, named).thresholds(part), part, named)
