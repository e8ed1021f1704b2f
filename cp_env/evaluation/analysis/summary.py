"""Summary of episodes: one row for each defender, attack and number of attackers, every value with its interval.

The unit is the scene, with all of its seeds. AP and AP recovery are pooled over frames, and their intervals are
bootstrapped over scenes. The other values are means over a scene's episodes, with Student's t over scenes, cut at
what is possible (no count below 0, no share above 1).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import groupby

import numpy as np
from jaxtyping import Int

from cp_env.evaluation.plan.records import IOUS, PooledApMeter, Record
from cp_env.evaluation.plan.runs import NO_ATTACK, Run
from cp_env.metrics.average_precision import resampled_ap
from cp_env.metrics.identification import id_rate, mc_rate, recovery
from cp_env.metrics.intervals import Interval, bootstrap_interval, t_interval

BOOTSTRAP_SEED = 0
Statistic = Callable[[Int[np.ndarray, " R"]], float]


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
    recovery50: (
        Interval | None
    )  # share of the AP@0.5 the attack takes from an undefended ego that the defender restores
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


def summarise(results: Mapping[Run, Sequence[Record]], *, resamples: int = 1000) -> list[Row]:
    """The rows of the table, in the order in which the plan names them."""
    groups: dict[tuple[str, str, int], list[Record]] = {}
    for run, records in results.items():
        groups.setdefault((run.defender, run.attack, run.k), []).extend(records)
    rows = []
    for (defender, attack, k), records in groups.items():
        undefended = groups.get(("none", attack, k)) if attack != NO_ATTACK else None
        clean = groups.get(("none", NO_ATTACK, 0))
        rows.append(_row(defender, attack, k, records, undefended, clean, resamples))
    return rows


def mean_ap(groups: Sequence[Sequence[Record]], iou: float, *, resamples: int = 1000) -> Interval:
    """AP averaged over groups of episodes that played the same scenes; its interval is bootstrapped over scenes.

    Args:
        groups: of episodes.
        iou: threshold of a match.
        resamples: of the bootstrap.

    Raises:
        ValueError: groups with different scenes.
    """
    scenes = {tuple(_by_scene(records)) for records in groups}
    if len(scenes) != 1:
        raise ValueError(f"an average over groups needs the same scenes in each; got {sorted(scenes)}")
    parts = [_pooled(list(records), iou) for records in groups]

    @cache
    def mean(rows: tuple[int, ...]) -> float:
        return float(np.mean([part(np.array(rows)) for part in parts]))

    return _bootstrap(lambda rows: mean(tuple(sorted(rows.tolist()))), len(*scenes), resamples)  # few scenes recur


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

    def ap(iou: float) -> Interval:
        return _bootstrap(_pooled(records, iou), len(scenes), resamples)

    def recovered(iou: float) -> Interval | None:
        if (
            undefended is None
            or clean is None
            or not _by_scene(undefended).keys() == _by_scene(clean).keys() == scenes.keys()
        ):
            return None
        ours, theirs, best = (_pooled(of, iou) for of in (records, undefended, clean))
        return _bootstrap(lambda rows: recovery(ours(rows), theirs(rows), best(rows)), len(scenes), resamples)

    def mean(metric: Callable[[Record], float | None], upper: float = math.inf) -> Interval | None:
        values = [[value for r in scene if (value := metric(r)) is not None] for scene in scenes.values()]
        means = np.array([np.mean(scene) for scene in values if scene])
        if not len(means):
            return None
        interval = t_interval(means)
        return replace(interval, low=max(interval.low, 0.0), high=min(interval.high, upper))

    def mean_of_all(metric: Callable[[Record], float], upper: float = math.inf) -> Interval:
        interval = mean(metric, upper)
        assert interval is not None
        return interval

    return Row(
        defender=defender,
        attack=attack,
        k=k,
        n_scenes=len(scenes),
        n_episodes=len(records),
        n_errors=sum(r.error is not None for r in records),
        ap50=ap(IOUS[0]),
        ap70=ap(IOUS[1]),
        recovery50=recovered(IOUS[0]),
        recovery70=recovered(IOUS[1]),
        damage=mean_of_all(lambda r: float(np.mean(r.damage)), 1.0),
        verifications=mean_of_all(lambda r: float(np.mean(_verifications_under_attack(r)))),
        verifications_alarmed=mean(
            lambda r: (
                float(np.mean([v for v in _verifications_under_attack(r) if v]))
                if any(_verifications_under_attack(r))
                else None
            )
        ),
        verifications_max=max(max(r.verifications) for r in records),
        alarm_rate=mean_of_all(lambda r: float(np.mean([v > 0 for v in _verifications_under_attack(r)])), 1.0),
        convergence_rate=mean_of_all(lambda r: float(r.converged is not None), 1.0),
        frames_to_convergence=mean(lambda r: None if r.converged is None else r.converged - r.grace_frames + 1.0),
        id_rate=mean(lambda r: id_rate(r.suspects, r.attackers) if r.attackers else None, 1.0),
        mc_rate=mean_of_all(lambda r: mc_rate(r.suspects, r.attackers, r.n_maps), 1.0),
        frames_per_second=sum(len(r.damage) for r in records) / max(sum(r.seconds for r in records), 1e-9),
    )


def _verifications_under_attack(record: Record) -> tuple[int, ...]:
    """Verifications of the frames in which an attack could act; all of them if the episode ended before."""
    return record.verifications[record.grace_frames :] or record.verifications


def _by_scene(records: Iterable[Record]) -> dict[str, list[Record]]:
    ordered = sorted(records, key=lambda record: record.scene)
    return {scene: list(same) for scene, same in groupby(ordered, key=lambda record: record.scene)}


def _pooled(records: list[Record], iou: float) -> Statistic:
    """AP of the scenes whose rows are given, all seeds of a scene together."""
    meters = [PooledApMeter.pool([r.meter for r in same]) for same in _by_scene(records).values()]
    return resampled_ap(meters, iou)


def _bootstrap(statistic: Statistic, n: int, resamples: int) -> Interval:
    return bootstrap_interval(statistic, n, seed=BOOTSTRAP_SEED, resamples=resamples)
