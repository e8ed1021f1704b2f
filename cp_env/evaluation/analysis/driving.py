"""The driving table: what the driver feels, who is found out, and what the defence takes; a row as in the summary.

The unit is the scene, with all of its seeds. Frames of grace do not count. Shares have Gaffke's interval over scenes,
counts Student's t, cut at 0 (see `metrics.shares`, `metrics.intervals`). ROC figures pool vehicles and frames and have
no interval.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from cp_env.evaluation.plan.driving_record import DrivingRecord
from cp_env.evaluation.plan.records import PooledApMeter, Record
from cp_env.metrics.identification import Roc, roc
from cp_env.metrics.intervals import Interval, rate_interval, t_interval
from cp_env.metrics.shares import share_interval

HARD = 4.0
"""An episode in which missed vehicles demand harder braking than this is dangerous; m/s²."""

Value = Callable[[DrivingRecord, int], float | None]


@dataclass(frozen=True)
class DrivingRow:
    """The driving figures of one row. A value that has no meaning there is None."""

    critical_recall: Interval | None
    critical_ap: Interval | None  # at 0.5
    certified: Interval | None  # share of the vehicles that no k attackers can hide from a vote of single views
    removal: Interval | None  # share of frames in which the nearest vehicle was removed
    spoofing: Interval | None  # share of frames with a spoofed car in the way
    streak: Interval | None  # longest run of frames with either
    mdr: Interval | None  # m/s²
    mdr_hard: Interval | None  # rate of episodes above 4 m/s²
    fsr: Interval | None  # m/s lost in a minute
    collisions: Interval | None  # rate of episodes
    hard_brakings: Interval | None  # an episode
    min_time_to_collision: Interval | None  # s, over the episodes that have one
    mean_speed: Interval | None  # m/s
    auc: float | None  # of the belief, vehicles and frames
    tpr_at_3: float | None  # share of attackers flagged at a threshold that flags at most 3 % of the benign
    decodes: Interval | None  # per frame
    milliseconds: float  # per frame
    late: Interval | None  # share of frames past the deadline


def driving_row(records: Sequence[Record], clean: Sequence[Record] = ()) -> DrivingRow | None:
    """The figures of some episodes; None if their driving was not recorded.

    Args:
        records: episodes of one defender under one attack.
        clean: of the same defender without an attack. Their vehicles are the benign ones of the ROC, so that its false
            alarms are those of the defence alone; without them they are the benign vehicles of `records`.
    """
    known = [record for record in records if record.driving is not None]
    return _row(known, belief_roc(known, clean)) if known else None


def belief_roc(records: Sequence[Record], clean: Sequence[Record]) -> Roc | None:
    """The ROC of a defender's belief; None without one, or without attackers.

    Args:
        records: episodes under an attack.
        clean: of the same defender without an attack.
    """
    malicious = [_beliefs(record, malicious=True) for record in records]
    benign = [_beliefs(record, malicious=False) for record in clean or records]
    yes, no = (np.concatenate([np.zeros(0), *parts]) for parts in (malicious, benign))
    return roc(no, yes) if yes.size and no.size else None


def _beliefs(record: Record, *, malicious: bool) -> np.ndarray:
    """The belief in each attacker, or in each benign vehicle, after the grace frames."""
    if record.driving is None:
        return np.zeros(0)
    rows = record.driving.beliefs(record.n_maps)[record.grace_frames :]
    return rows[:, np.isin(np.arange(record.n_maps), record.attackers) == malicious].ravel()


def _row(records: list[Record], curve: Roc | None) -> DrivingRow:
    def by_scene(value: Value) -> list[list[float]]:
        values: dict[str, list[float]] = {}
        for record in records:
            assert record.driving is not None
            if (found := value(record.driving, record.grace_frames)) is not None:
                values.setdefault(record.scene, []).append(float(found))
        return list(values.values())

    def means(value: Value) -> list[float]:
        return [float(np.mean(same)) for same in by_scene(value)]

    def share(value: Value) -> Interval | None:
        values = means(value)
        return share_interval(values) if values else None

    def rate(happens: Callable[[DrivingRecord], bool]) -> Interval | None:
        """Exact bounds where every scene has one episode; episodes of one scene are not independent."""
        values = by_scene(lambda driving, _: float(happens(driving)))
        if any(len(same) > 1 for same in values):
            return share(lambda driving, _: float(happens(driving)))
        return rate_interval(int(sum(map(sum, values))), len(values)) if values else None

    def count(value: Value) -> Interval | None:
        values = means(value)
        return t_interval(values, least=0.0) if values else None

    return DrivingRow(
        critical_recall=share(DrivingRecord.recall),
        critical_ap=_critical_ap(records),
        certified=share(DrivingRecord.certified_recall),
        removal=share(DrivingRecord.removal),
        spoofing=share(DrivingRecord.spoofing),
        streak=count(DrivingRecord.streak),
        mdr=count(lambda driving, _: driving.mdr),
        mdr_hard=rate(lambda driving: driving.mdr > HARD),
        fsr=count(lambda driving, _: driving.fsr),
        collisions=rate(lambda driving: driving.collided),
        hard_brakings=count(lambda driving, _: driving.hard_brakings),
        min_time_to_collision=count(lambda driving, _: driving.min_time_to_collision),
        mean_speed=count(lambda driving, _: driving.mean_speed),
        auc=None if curve is None else curve.auc,
        tpr_at_3=None if curve is None else curve.tpr_at(0.03),
        decodes=count(lambda driving, grace: float(np.mean(driving.decodes[grace:] or driving.decodes))),
        milliseconds=1000 * sum(r.seconds for r in records) / sum(len(r.damage) for r in records),
        late=share(lambda driving, _: driving.late_frames / len(driving.critical)),
    )


def critical_ap(records: Sequence[Record]) -> float | None:
    """Critical AP@0.5, pooled over episodes; None without a critical vehicle or without a recording of it."""
    meters = [record.critical_meter for record in records if record.critical_meter is not None]
    if not sum(meter.n_truth for meter in meters):
        return None
    return PooledApMeter.pool(meters).value(0.5)


def _critical_ap(records: Sequence[Record]) -> Interval | None:
    """Mean over scenes of the critical AP of each."""
    by_scene: dict[str, list[Record]] = {}
    for record in records:
        by_scene.setdefault(record.scene, []).append(record)
    values = [value for same in by_scene.values() if (value := critical_ap(same)) is not None]
    return share_interval(values) if values else None
