"""Worst cases: what every defender has left under the attacker that is worst for it in each scene, and the reverse.

A defender's figure in a scene is its mean over the scene's seeds; the worst attacker of the scene is the one with the
highest damage a frame. The standing is the mean over scenes of that worst figure, with Student's t over scenes: each
scene chooses its own attacker, so it is never better than the figure under any one of them. An attacker's standing is
the damage that the best defence of each scene leaves. Defenders that are told who lies bound what a defence can reach:
they are listed, but neither ranked nor counted as anybody's best defence.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cp_env.evaluation.plan.grid import Board, Played
from cp_env.evaluation.plan.records import IOUS, Counted, Record
from cp_env.evaluation.plan.runs import NOBODY
from cp_env.metrics.intervals import Interval, t_interval

Scores = Mapping[str, Mapping[str, Mapping[str, float]]]
"""A figure by entry, opponent and scene."""
Choose = Callable[[Sequence[float]], float]


@dataclass(frozen=True)
class Standing:
    """One line of a ranking: defenders by the least damage in their worst case, attackers by the most that is left."""

    entry: str
    rank: int | None  # None for those that are told who lies
    damage: Interval  # a frame, under the worst opponent of each scene
    ap50: Interval  # AP@0.5 of a scene under the opponent that is worst in this figure
    opponents: tuple[tuple[str, int], ...]  # in how many scenes which one did the most damage (or left the least)


def damage_a_frame(record: Record, frames: int) -> float:
    """Mean damage over the frames in which an attack could act. Those that a failing defender never saw count as 1."""
    acted = list(record.damage[record.grace_frames :])
    if record.error is not None:
        acted += [1.0] * (frames - len(record.damage))
    return float(np.mean(acted or record.damage))


def scores(played: Played, k: int, figure: Callable[[list[Record]], float]) -> Scores:
    """`figure` of every scene's episodes, by defender, attack and scene: of scenes that every pair has played."""
    episodes: dict[str, dict[str, dict[str, list[Record]]]] = {}
    for cell, records in played.items():
        if cell.k == k and cell.attack != NOBODY:
            for record in records:
                by_scene = episodes.setdefault(cell.defender, {}).setdefault(cell.attack, {})
                by_scene.setdefault(record.scene, []).append(record)
    pairs = [by_scene for attacks in episodes.values() for by_scene in attacks.values()]
    common = set.intersection(*(set(pair) for pair in pairs)) if pairs else set()
    return {
        defender: {
            attack: {scene: figure(by_scene[scene]) for scene in sorted(common)} for attack, by_scene in attacks.items()
        }
        for defender, attacks in episodes.items()
    }


def damages(board: Board, played: Played) -> Scores:
    """Damage a frame, by defender, attack and scene."""
    frames = board.protocol.frames
    return scores(played, board.k, lambda records: float(np.mean([damage_a_frame(r, frames) for r in records])))


def precisions(board: Board, played: Played) -> Scores:
    """AP@0.5 of a scene, its seeds pooled, by defender, attack and scene."""
    return scores(played, board.k, lambda records: Counted.pool([r.meter for r in records]).value(IOUS[0]))


def extremes(by_opponent: Mapping[str, Mapping[str, float]], choose: Choose) -> dict[str, tuple[float, str]]:
    """Scene by scene the figure that `choose` takes (max or min), and whose it is; the first named wins a tie."""
    scenes = next(iter(by_opponent.values()), {})
    found = {}
    for scene in scenes:
        best = choose([figures[scene] for figures in by_opponent.values()])
        found[scene] = best, next(name for name, figures in by_opponent.items() if figures[scene] == best)
    return found


def mean_of(found: Mapping[str, tuple[float, str]]) -> Interval:
    """Mean over scenes with Student's t, cut at what a share can be."""
    interval = t_interval([value for value, _ in found.values()])
    return replace(interval, low=max(interval.low, 0.0), high=min(interval.high, 1.0))


def rank_defenders(damage: Scores, ap50: Scores, told: Collection[str] = ()) -> list[Standing]:
    """By the damage under the worst attacker of each scene, least first. `told` are listed last, without a rank."""
    made = [
        _standing(name, extremes(damage[name], max), extremes(ap50[name], min)) for name in damage if _any(damage[name])
    ]
    return _ranked(made, told, ascending=True)


def rank_attackers(damage: Scores, ap50: Scores, told: Collection[str] = ()) -> list[Standing]:
    """By the damage that the best defence of each scene leaves, most first. No defence counts that is `told`."""
    by_attack, ap_by_attack = (_turned({d: of[d] for d in of if d not in told}) for of in (damage, ap50))
    made = [
        _standing(name, extremes(by_attack[name], min), extremes(ap_by_attack[name], max))
        for name in by_attack
        if _any(by_attack[name])
    ]
    return _ranked(made, (), ascending=False)


def _any(by_opponent: Mapping[str, Mapping[str, float]]) -> bool:
    return any(by_opponent.values())


def _turned(table: Scores) -> dict[str, dict[str, Mapping[str, float]]]:
    """Attack by defender instead of defender by attack."""
    turned: dict[str, dict[str, Mapping[str, float]]] = {}
    for defender, attacks in table.items():
        for attack, figures in attacks.items():
            turned.setdefault(attack, {})[defender] = figures
    return turned


def _standing(name: str, damage: dict[str, tuple[float, str]], ap50: dict[str, tuple[float, str]]) -> Standing:
    opponents = Counter(opponent for _, opponent in damage.values())
    return Standing(name, None, mean_of(damage), mean_of(ap50), tuple(opponents.most_common()))


def _ranked(made: list[Standing], told: Collection[str], *, ascending: bool) -> list[Standing]:
    sign = 1 if ascending else -1
    ordered = sorted(made, key=lambda standing: (standing.entry in told, sign * standing.damage.mean))
    return [s if s.entry in told else replace(s, rank=1 + i) for i, s in enumerate(ordered)]
