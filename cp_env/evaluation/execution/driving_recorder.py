"""The driving measures of one world's episode while it runs."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Int

from cp_env.driving.closed_loop import PseudoClosedLoop
from cp_env.evaluation.plan.driving_record import DrivingRecord, believed
from cp_env.metrics.certified import is_certified
from cp_env.metrics.critical import CriticalApMeter
from cp_env.metrics.severity import SeverityMeter
from cp_env.world.situation import Outcome
from defenders.protocol import Defender

DEADLINE = 0.1
"""A frame that takes longer is late: its output would act on what is past; s. Ten frames a second, our choice."""

RECORDED = ("critical", "critical_missed", "removable", "removed", "spoofed", "decodes")


class DrivingRecorder:
    """Reads outcomes, frame by frame, and makes a `DrivingRecord` of them."""

    def __init__(self, n_maps: int) -> None:
        self.n_maps = n_maps
        self.meter = CriticalApMeter()
        self._severity = SeverityMeter()
        self._loop: PseudoClosedLoop | None = None
        self._frames: dict[str, list[int]] = {name: [] for name in RECORDED}
        self._belief: list[float] | None = []
        self._late = 0
        self._vehicles: list[int] = []
        self._certified: list[int] = []

    def add(self, outcome: Outcome, e: int, defender: Defender, witnesses: Int[np.ndarray, " L"] | None = None) -> None:
        """Record one frame of world `e`, and what its defender believes after it.

        Args:
            outcome: of all worlds.
            e: the world.
            defender: of it.
            witnesses: how many single views find each true vehicle, where that is known.
        """
        output, around = outcome.output[e], outcome.surroundings[e]
        self.meter.add_critical(output.detections, around)
        self._severity.add(output.seen.boxes, around)
        if self._loop is None:
            scene, frame, _ = outcome.traffic[e]
            self._loop = PseudoClosedLoop([scene], [frame])
        self._loop.step([output])
        found, there = outcome.critical[e].tolist()
        flags = (outcome.removable[e], outcome.removed[e], outcome.spoofed[e], outcome.decodes[e])
        for values, value in zip(self._frames.values(), (there, there - found, *flags), strict=True):
            values.append(int(value))
        if witnesses is not None:
            self._vehicles.append(len(witnesses))
            self._certified.append(int(is_certified(witnesses, outcome.attackers.shape[1]).sum()))
        self._late += outcome.seconds / len(outcome.judgements) > DEADLINE
        belief = _belief(defender, self.n_maps)
        self._belief = None if self._belief is None or not belief else [*self._belief, *belief]

    def record(self) -> DrivingRecord:
        """What was recorded so far, of at least one frame."""
        assert self._loop is not None
        (drive,) = self._loop.drives()
        nearest = drive.min_time_to_collision
        return DrivingRecord(
            **{name: tuple(values) for name, values in self._frames.items()},
            vehicles=tuple(self._vehicles),
            certified=tuple(self._certified),
            belief=tuple(self._belief or ()),
            late_frames=self._late,
            mdr=round(self._severity.mdr, 6),
            fsr=round(self._severity.fsr, 6),
            collided=drive.collided,
            hard_brakings=drive.hard_brakings,
            hardest_braking=round(drive.hardest_braking, 6),
            impact_speed=round(drive.impact_speed, 6),
            min_time_to_collision=None if math.isinf(nearest) else round(nearest, 6),
            mean_speed=round(drive.mean_speed, 6),
        )


def _belief(defender: Defender, n_maps: int) -> list[float]:
    """Its belief; nothing if asking fails, which is for `inspect` to report."""
    try:
        return list(believed(defender.belief(), n_maps))
    except Exception:
        return []
