"""Worst cases: the damage of every defender under the attack that is worst for it in each scene, and the reverse.

A defender's value in a scene is its mean over the scene's seeds; the worst attack of the scene is the one with the
highest damage per frame. A defender's score is the mean over scenes of that worst value, with Student's t over scenes:
each scene chooses its own attack, so the score is never better than the value under any one of them. An attack's score
is the damage that the best defence of each scene leaves. Defenders that are given the attackers bound what a defence
can reach: they are listed, but neither ranked nor counted as the best defence.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cp_env.evaluation.plan.grid import Grid, Results
from cp_env.evaluation.plan.records import IOUS, PooledApMeter, Record
from cp_env.evaluation.plan.runs import NO_ATTACK
from cp_env.metrics.intervals import Interval, t_interval

Scores = Mapping[str, Mapping[str, Mapping[str, float]]]
"""A value by entry, opponent and scene."""
Choose = Callable[[Sequence[float]], float]


@dataclass(frozen=True)
class Ranking:
    """One line of a ranking: defenders by the least damage in their worst case, attacks by the most that is left."""

    entry: str
    rank: int | None  # None for those that are given the attackers
    damage: Interval  # per frame, under the worst opponent of each scene
    ap50: Interval  # AP@0.5 of a scene under the opponent that is worst in this metric
    opponents: tuple[tuple[str, int], ...]  # in how many scenes which one did the most damage (or left the least)


def damage_per_frame(record: Record, frames: int) -> float:
    """Mean damage over the frames in which an attack could act.

    Frames that a failing defender never saw count as 1.
    """
    acted = list(record.damage[record.grace_frames :])
    if record.error is not None:
        acted += [1.0] * (frames - len(record.damage))
    return float(np.mean(acted or record.damage))


def scores(results: Results, k: int, metric: Callable[[list[Record]], float]) -> Scores:
    """`metric` of every scene's episodes, by defender, attack and scene: of scenes that every pair has played."""
    episodes: dict[str, dict[str, dict[str, list[Record]]]] = {}
    for run, records in results.items():
        if run.k == k and run.attack != NO_ATTACK:
            for record in records:
                by_scene = episodes.setdefault(run.defender, {}).setdefault(run.attack, {})
                by_scene.setdefault(record.scene, []).append(record)
    pairs = [by_scene for attacks in episodes.values() for by_scene in attacks.values()]
    common = set.intersection(*(set(pair) for pair in pairs)) if pairs else set()
    return {
        defender: {
            attack: {scene: metric(by_scene[scene]) for scene in sorted(common)} for attack, by_scene in attacks.items()
        }
        for defender, attacks in episodes.items()
    }


def damages(grid: Grid, results: Results) -> Scores:
    """Damage per frame, by defender, attack and scene."""
    frames = grid.conditions.frames
    return scores(results, grid.k, lambda records: float(np.mean([damage_per_frame(r, frames) for r in records])))


def average_precisions(grid: Grid, results: Results) -> Scores:
    """AP@0.5 of a scene, its seeds pooled, by defender, attack and scene."""
    return scores(results, grid.k, lambda records: PooledApMeter.pool([r.meter for r in records]).value(IOUS[0]))


def extremes(by_opponent: Mapping[str, Mapping[str, float]], choose: Choose) -> dict[str, tuple[float, str]]:
    """Scene by scene the value that `choose` takes (max or min), and its opponent; the first named wins a tie."""
    scenes = next(iter(by_opponent.values()), {})
    found = {}
    for scene in scenes:
        best = choose([by_scene[scene] for by_scene in by_opponent.values()])
        found[scene] = best, next(name for name, by_scene in by_opponent.items() if by_scene[scene] == best)
    return found


def mean_interval(found: Mapping[str, tuple[float, str]]) -> Interval:
    """Mean over scenes with Student's t, cut at what a share can be."""
    interval = t_interval([value for value, _ in found.values()])
    return replace(interval, low=max(interval.low, 0.0), high=min(interval.high, 1.0))


def rank_defenders(damage: Scores, ap50: Scores, informed: Collection[str] = ()) -> list[Ranking]:
    """Defenders by the damage under the worst attack of each scene, least first; `informed` ones last, unranked."""
    made = [
        _ranking(name, extremes(damage[name], max), extremes(ap50[name], min)) for name in damage if _any(damage[name])
    ]
    return _ranked(made, informed, ascending=True)


def rank_attacks(damage: Scores, ap50: Scores, informed: Collection[str] = ()) -> list[Ranking]:
    """Attacks by the damage that the best defence of each scene leaves, most first; `informed` ones do not count."""
    by_attack, ap_by_attack = (_transposed({d: of[d] for d in of if d not in informed}) for of in (damage, ap50))
    made = [
        _ranking(name, extremes(by_attack[name], min), extremes(ap_by_attack[name], max))
        for name in by_attack
        if _any(by_attack[name])
    ]
    return _ranked(made, (), ascending=False)


def _any(by_opponent: Mapping[str, Mapping[str, float]]) -> bool:
    return any(by_opponent.values())


def _transposed(table: Scores) -> dict[str, dict[str, Mapping[str, float]]]:
    """Attack by defender instead of defender by attack."""
    turned: dict[str, dict[str, Mapping[str, float]]] = {}
    for defender, attacks in table.items():
        for attack, by_scene in attacks.items():
            turned.setdefault(attack, {})[defender] = by_scene
    return turned


def _ranking(name: str, damage: dict[str, tuple[float, str]], ap50: dict[str, tuple[float, str]]) -> Ranking:
    opponents = Counter(opponent for _, opponent in damage.values())
    return Ranking(name, None, mean_interval(damage), mean_interval(ap50), tuple(opponents.most_common()))


def _ranked(made: list[Ranking], informed: Collection[str], *, ascending: bool) -> list[Ranking]:
    sign = 1 if ascending else -1
    ordered = sorted(made, key=lambda ranking: (ranking.entry in informed, sign * ranking.damage.mean))
    return [s if s.entry in informed else replace(s, rank=1 + i) for i, s in enumerate(ordered)]
