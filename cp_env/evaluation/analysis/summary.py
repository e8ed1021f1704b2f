"""Summary of episodes: one row for each defender, attack and number of attackers, every value with its interval.

The unit is the scene, with all of its seeds: episodes of one scene share its traffic, so they do not count as
independent. With one seed a unit is an episode. Shares have Gaffke's interval over scenes, AP the same with one more
scene in place of one more value (see `metrics.shares`). Counts have Student's t over scenes, cut at 0, and AP recovery,
which has no bounds, Student's t over its jackknife values. The convergence rate counts episodes, with exact bounds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import groupby
from typing import Any

import numpy as np

from cp_env.evaluation.analysis.driving import DrivingRow, driving_row
from cp_env.evaluation.analysis.measures import MEASURES
from cp_env.evaluation.plan.records import IOUS, PooledApMeter, Record
from cp_env.evaluation.plan.runs import NO_ATTACK, Run
from cp_env.metrics.average_precision import resampled_ap
from cp_env.metrics.identification import id_rate, mc_rate, recovery
from cp_env.metrics.intervals import Interval, Statistic, jackknife_interval, rate_interval, t_interval
from cp_env.metrics.shares import pooled_share_interval, share_interval

BOOTSTRAP_SEED = 0


@dataclass(frozen=True)
class Row:
    """One row of the table. A value that has no meaning there (the ID rate without an attack) is None."""

    defender: str
    attack: str
    k: int
    n_scenes: int
    n_episodes: int
    n_errors: int  # episodes the defender's own failure ended
    ap50: Interval  # of the output, by the benchmark's AP protocol
    ap70: Interval
    recovery50: Interval | None  # share of the AP@0.5 that the attack takes from `none` and that is restored
    recovery70: Interval | None
    damage: Interval  # 1 - Jaccard, mean over the frames of an episode
    verifications: Interval  # per frame
    verifications_alarmed: Interval | None  # per frame with at least one
    verifications_max: int
    alarm_rate: Interval  # share of frames in which the defender verified at all
    convergence_rate: Interval  # share of episodes in which the defender came to a conclusion
    frames_to_convergence: Interval | None  # of attack, where it did
    id_rate: Interval | None  # share of the attackers flagged when it converged, or at the end
    mc_rate: Interval  # share of the benign vehicles flagged then
    frames_per_second: float  # of defended frames, the attack's time left out
    driving: DrivingRow | None = None  # None if it was not recorded
    measures: Mapping[str, Interval | None] = field(default_factory=dict)  # those of `MEASURES` that are columns

    def value(self, name: str) -> Interval | float | None:
        """The value of a field or of a measure."""
        found: Interval | float | None = self.measures[name] if name in self.measures else getattr(self, name)
        return found

    def to_json(self) -> dict[str, Any]:
        """All values, those of the measures among them."""
        plain = asdict(self)
        measures: dict[str, Any] = plain.pop("measures")
        return plain | measures


def summarise(results: Mapping[Run, Sequence[Record]], *, resamples: int = 1000) -> list[Row]:
    """The rows of the table, in the order in which the plan names them.

    Args:
        results: the episodes of each run.
        resamples: Dirichlet weights of the intervals of AP.

    Returns:
        A row for each defender, attack and number of attackers.
    """
    groups: dict[tuple[str, str, int], list[Record]] = {}
    for run, records in results.items():
        groups.setdefault((run.defender, run.attack, run.k), []).extend(records)
    rows = []
    for (defender, attack, k), records in groups.items():
        undefended = groups.get(("none", attack, k)) if attack != NO_ATTACK else None
        clean = groups.get(("none", NO_ATTACK, 0))
        row = _row(defender, attack, k, records, undefended, clean, resamples)
        rows.append(replace(row, driving=driving_row(records, groups.get((defender, NO_ATTACK, 0), ()))))
    return rows


def mean_ap(groups: Sequence[Sequence[Record]], iou: float, *, resamples: int = 1000) -> Interval:
    """AP averaged over groups of episodes that played the same scenes, with its interval over scenes.

    Args:
        groups: of episodes.
        iou: threshold of a match.
        resamples: Dirichlet weights of the interval.

    Raises:
        ValueError: groups with different scenes.
    """
    scenes = {tuple(_by_scene(records)) for records in groups}
    if len(scenes) != 1:
        raise ValueError(f"an average over groups needs the same scenes in each; got {sorted(scenes)}")
    pools = [_pool(list(records)) for records in groups]

    def mean(further: Callable[[Sequence[PooledApMeter]], list[PooledApMeter]]) -> Statistic:
        parts = [resampled_ap([*pool, *further(pool)], iou) for pool in pools]
        return lambda rows: float(np.mean([part(rows) for part in parts]))

    statistics = mean(lambda pool: []), mean(lambda pool: [nothing_found(pool)]), mean(lambda pool: [all_found(pool)])
    return pooled_share_interval(*statistics, len(*scenes), seed=BOOTSTRAP_SEED, resamples=resamples)


def _row(
    defender: str,
    attack: str,
    k: int,
    records: list[Record],
    undefended: list[Record] | None,
    clean: list[Record] | None,
    resamples: int,
) -> Row:
    scenes = _by_scene(records)
    frames = max(len(record.damage) for record in records)

    def recovered(iou: float) -> Interval | None:
        if undefended is None or clean is None:
            return None
        pools = [_pool([r for r in of if r.scene in scenes]) for of in (records, undefended, clean)]
        if {len(pool) for pool in pools} != {len(scenes)}:
            return None
        ours, theirs, best = (resampled_ap(pool, iou) for pool in pools)
        return jackknife_interval(lambda rows: recovery(ours(rows), theirs(rows), best(rows)), len(scenes))

    def means(metric: Callable[[Record], float | None]) -> list[float]:
        values = [[value for r in scene if (value := metric(r)) is not None] for scene in scenes.values()]
        return [float(np.mean(scene)) for scene in values if scene]

    def share(metric: Callable[[Record], float]) -> Interval:
        return share_interval(means(metric))

    def count(metric: Callable[[Record], float | None]) -> Interval | None:
        values = means(metric)
        return t_interval(values, least=0.0) if values else None

    verifications = count(lambda r: float(np.mean(_verifications_under_attack(r))))
    assert verifications is not None
    return Row(
        defender=defender,
        attack=attack,
        k=k,
        n_scenes=len(scenes),
        n_episodes=len(records),
        n_errors=sum(r.error is not None for r in records),
        ap50=mean_ap([records], IOUS[0], resamples=resamples),
        ap70=mean_ap([records], IOUS[1], resamples=resamples),
        recovery50=recovered(IOUS[0]),
        recovery70=recovered(IOUS[1]),
        damage=share(lambda r: float(np.mean(r.damage))),
        verifications=verifications,
        verifications_alarmed=count(
            lambda r: (
                float(np.mean([v for v in _verifications_under_attack(r) if v]))
                if any(_verifications_under_attack(r))
                else None
            )
        ),
        verifications_max=max(max(r.verifications) for r in records),
        alarm_rate=share(lambda r: float(np.mean([v > 0 for v in _verifications_under_attack(r)]))),
        convergence_rate=rate_interval(sum(r.converged is not None for r in records), len(records)),
        frames_to_convergence=count(lambda r: None if r.converged is None else r.converged - r.grace_frames + 1.0),
        id_rate=share(lambda r: id_rate(r.suspects, r.attackers)) if records[0].attackers else None,
        mc_rate=share(lambda r: mc_rate(r.suspects, r.attackers, r.n_maps)),
        frames_per_second=sum(len(r.damage) for r in records) / max(sum(r.seconds for r in records), 1e-9),
        measures={name: of.summary(scenes.values(), frames) for name, of in MEASURES.items() if of.column},
    )


def _verifications_under_attack(record: Record) -> tuple[int, ...]:
    """Verifications of the frames in which an attack could act; all of them if the episode ended before."""
    return record.verifications[record.grace_frames :] or record.verifications


def _by_scene(records: Iterable[Record]) -> dict[str, list[Record]]:
    ordered = sorted(records, key=lambda record: record.scene)
    return {scene: list(same) for scene, same in groupby(ordered, key=lambda record: record.scene)}


def _pool(records: Sequence[Record]) -> list[PooledApMeter]:
    """A meter for each scene, all seeds of a scene together."""
    return [PooledApMeter.pool([r.meter for r in same]) for same in _by_scene(records).values()]


def nothing_found(pool: Sequence[PooledApMeter]) -> PooledApMeter:
    """One more scene, with as many vehicles as the others have on average, none of which was found."""
    return _further_scene(pool, 0)


def all_found(pool: Sequence[PooledApMeter]) -> PooledApMeter:
    """One more scene, in which every vehicle was found, with scores above all others."""
    return _further_scene(pool, _vehicles(pool))


def _further_scene(pool: Sequence[PooledApMeter], found: int) -> PooledApMeter:
    above = 1.0 + max((float(meter.matched(IOUS[0])[0].max(initial=0.0)) for meter in pool), default=0.0)
    hits = {iou: np.ones(found, dtype=bool) for iou in IOUS}
    return PooledApMeter(np.full(found, above), hits, _vehicles(pool), 1, pool[0].protocol)


def _vehicles(pool: Sequence[PooledApMeter]) -> int:
    return max(1, round(float(np.mean([meter.n_truth for meter in pool]))))
