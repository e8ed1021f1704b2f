"""The driving measures of a frame of many worlds, where what they share is computed once.

`critical`, `severity` and `targeted` say what each measure is, one output at a time; here are the same numbers. What
depends on the traffic alone, or on the clean view, is remembered for as long as those are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np
from jaxtyping import Bool, Float, Int

from cp_env.geometry.boxes import overlaps
from cp_env.metrics import targeted
from cp_env.metrics.critical import MATCH
from cp_env.metrics.severity import ghosts, near
from cp_env.metrics.surroundings import Surroundings
from cp_env.types import View, frozen

_JUST_BELOW = float(np.nextafter(MATCH, 0.0))  # an IoU above this is at least `MATCH`


@dataclass(frozen=True, eq=False)
class DrivingMeasures:
    """Each measure of E outputs, computed for all worlds when it is first asked for. All arrays are read-only.

    Attributes:
        output: the boxes that each ego acts on, in its grid frame.
        clean: each ego's unattacked view.
        around: the true traffic of each; only what is computed of it is kept there.
    """

    output: Sequence[Float[np.ndarray, "_ 5"]]
    clean: Sequence[View]
    around: Sequence[Surroundings]

    @cached_property
    def critical(self) -> Int[np.ndarray, "E 2"]:
        """How many critical vehicles each output finds, and how many there are."""
        counts = [
            (int((hit & around.critical[around.targets]).sum()), int(around.critical.sum()))
            for hit, around in zip(self._found, self.around, strict=True)
        ]
        return frozen(np.array(counts, dtype=np.int64).reshape(-1, 2))

    @cached_property
    def miss_severity(self) -> Float[np.ndarray, " E"]:
        """The hardest braking that a missed vehicle demands; m/s²."""
        pairs = zip(self._near, self.around, strict=True)
        return frozen(np.array([around.deceleration[~close.any(0)].max(initial=0.0) for close, around in pairs]))

    @cached_property
    def ghost_severity(self) -> Float[np.ndarray, " E"]:
        """The hardest braking that a ghost demands; m/s²."""
        return frozen(np.array([0.0 if g is None else g.deceleration.max(initial=0.0) for g in self._ghosts]))

    @cached_property
    def removable(self) -> Bool[np.ndarray, " E"]:
        """Whether the nearest vehicle is found in the clean view."""
        return frozen(np.array([one.removable for one in self._of_clean], dtype=bool))

    @cached_property
    def removed(self) -> Bool[np.ndarray, " E"]:
        """Whether it is, and is missing in the output."""
        parts = zip(self._found, self._of_clean, self.around, strict=True)
        missing = [clean.removable and not hit[around.targets == around.nearest].any() for hit, clean, around in parts]
        return frozen(np.array(missing, dtype=bool))

    @cached_property
    def spoofed(self) -> Bool[np.ndarray, " E"]:
        """Whether an output holds a critical ghost that the clean view does not hold."""
        pairs = zip(self._ghosts, self._of_clean, strict=True)
        return frozen(np.array([g is not None and g.any_critical and not c.critical_ghost for g, c in pairs]))

    @cached_property
    def _found(self) -> list[Bool[np.ndarray, " W"]]:
        """Whether each output finds each of its traffic's targets."""
        hits = [np.zeros(len(around.targets), dtype=bool) for around in self.around]
        view, _, row, _ = overlaps(self.output, [around.target_boxes for around in self.around], above=_JUST_BELOW)
        for e, one in zip(view.tolist(), row.tolist(), strict=True):
            hits[e][one] = True
        return hits

    @cached_property
    def _near(self) -> list[Bool[np.ndarray, "B L"]]:
        """Which boxes of each output are within 2 m of which vehicle."""
        return [near(boxes, around.boxes) for boxes, around in zip(self.output, self.around, strict=True)]

    @cached_property
    def _ghosts(self) -> list[Surroundings | None]:
        """The boxes near no vehicle, taken as standing; None where there is none."""
        shown: list[Surroundings | None] = []
        for boxes, close, around in zip(self.output, self._near, self.around, strict=True):
            alone = ~close.any(axis=1)
            shown.append(around.standing(boxes[alone]) if alone.any() else None)
        return shown

    @cached_property
    def _of_clean(self) -> list[_OfClean]:
        return [of_clean(view, around) for view, around in zip(self.clean, self.around, strict=True)]


@dataclass(frozen=True, eq=False)
class _OfClean:
    """What is asked of a clean view."""

    around: Surroundings
    removable: bool
    critical_ghost: bool


def of_clean(view: View, around: Surroundings) -> _OfClean:
    """Whether a clean view finds the nearest vehicle, and whether it holds a critical ghost; remembered."""
    known = _CLEAN.get(view)
    if known is None or known.around is not around:
        boxes = view.seen.boxes
        known = _OfClean(around, targeted.removable(boxes, around), ghosts(boxes, around).any_critical)
        _CLEAN[view] = known
    return known


_CLEAN: WeakKeyDictionary[View, _OfClean] = WeakKeyDictionary()
"""No attack changes a clean view, so all outcomes of a frame share what is asked of it."""
