"""Worst cases: every defender under the attack that is worst for it, and the reverse.

Which attack is the worst is either screened on other scenes (`screened_attacks`), or looked up in each scene that is
reported on. Screened, a defender's score is its mean over the test scenes under one attack, which is named. Looked up,
it is the mean over scenes of the worst value of each: never better than under any one attack, and biased towards the
worse, since the attack is picked on the scenes it is reported on. An attack's score is what the best defence leaves.
A defender's value in a scene is its value over the scene's seeds. Defenders that are given the attackers bound what a
defence can reach: they are listed, but neither ranked nor counted as the best defence.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from cp_env.evaluation.analysis.comparisons import Difference, compare
from cp_env.evaluation.analysis.measures import Measure, damage_per_frame, headlines, measure_of
from cp_env.evaluation.analysis.ranks import Place, places
from cp_env.evaluation.plan.grid import Grid, Results
from cp_env.evaluation.plan.records import Record
from cp_env.evaluation.plan.runs import NO_ATTACK
from cp_env.metrics.intervals import Interval
from cp_env.metrics.shares import share_interval

__all__ = [
    "Ranking",
    "Scores",
    "compare_defenders",
    "damage_per_frame",
    "extremes",
    "mean_interval",
    "measured",
    "rank_attacks",
    "rank_defenders",
    "scores",
    "screened_attacks",
]

Scores = Mapping[str, Mapping[str, Mapping[str, float]]]
"""A value by entry, opponent and scene."""
Choose = Callable[[Sequence[float]], float]
Found = Mapping[str, tuple[float, str]]
"""A value by scene, and the opponent it is of."""


@dataclass(frozen=True)
class Ranking:
    """One line of a ranking: defenders by the best worst case, attacks by the worst that the best defence leaves."""

    entry: str
    rank: int | None  # None for those that are given the attackers
    by: str  # the measure that ranks
    values: Mapping[str, Interval]  # by measure, under the worst opponent
    opponents: tuple[tuple[str, int], ...]  # in how many scenes which one was the worst by that measure
    place: Place | None = field(default=None)  # how sure the rank is

    @property
    def value(self) -> Interval:
        """Of the measure that ranks."""
        return self.values[self.by]

    @property
    def damage(self) -> Interval:
        return self.values["damage"]

    @property
    def ap50(self) -> Interval:
        return self.values["ap50"]

    def to_json(self) -> dict[str, Any]:
        """All that there is, each measure by its name."""
        plain = {"entry": self.entry, "rank": self.rank, "by": self.by, "opponents": self.opponents}
        place = None if self.place is None else asdict(self.place)
        return {**plain, "place": place, **{name: asdict(interval) for name, interval in self.values.items()}}


def scores(results: Results, k: int, value: Callable[[list[Record]], float | None]) -> Scores:
    """The value of every scene's episodes, by defender, attack and scene.

    Only episodes (scene and seed) that every pair has played count, and of those only scenes where every pair has a
    value: all entries are compared over the same episodes.
    """
    episodes: dict[tuple[str, str], dict[tuple[str, int], Record]] = {}
    for run, records in results.items():
        if run.k == k and run.attack != NO_ATTACK:
            pair = episodes.setdefault((run.defender, run.attack), {})
            pair.update({(record.scene, run.seed): record for record in records})
    common = sorted(set.intersection(*map(set, episodes.values()))) if episodes else []
    scenes: dict[str, list[tuple[str, int]]] = {}
    for key in common:
        scenes.setdefault(key[0], []).append(key)
    values = {
        pair: {scene: value([of[key] for key in keys]) for scene, keys in scenes.items()}
        for pair, of in episodes.items()
    }
    known = [scene for scene in scenes if all(of[scene] is not None for of in values.values())]
    table: dict[str, dict[str, dict[str, float]]] = {}
    for (defender, attack), of in values.items():
        kept = {scene: found for scene in known if (found := of[scene]) is not None}
        table.setdefault(defender, {})[attack] = kept
    return table


def measured(grid: Grid, results: Results, measures: Collection[str] | None = None) -> dict[str, Scores]:
    """The scores of a grid by measure: those named, or all that every ranking shows."""
    frames = grid.conditions.frames

    def table(measure: Measure) -> Scores:
        return scores(results, grid.k, lambda records: measure.of_scene(records, frames))

    return {name: table(measure_of(name)) for name in (headlines() if measures is None else measures)}


def extremes(by_opponent: Mapping[str, Mapping[str, float]], choose: Choose) -> dict[str, tuple[float, str]]:
    """Scene by scene the value that `choose` takes (max or min), and its opponent; the first named wins a tie."""
    scenes = next(iter(by_opponent.values()), {})
    found = {}
    for scene in scenes:
        best = choose([by_scene[scene] for by_scene in by_opponent.values()])
        found[scene] = best, next(name for name, by_scene in by_opponent.items() if by_scene[scene] == best)
    return found


def screened_attacks(table: Scores, by: str, played: Scores) -> dict[str, str]:
    """The attack that is worst for each defender on the mean over the screening scenes; the first named wins a tie.

    Args:
        table: scores of the screening scenes in the measure `by`.
        by: name of a measure.
        played: scores of the scenes that are reported on; only attacks that the defender met there are picked.

    Returns:
        Attacks by defender; none for a defender that met no attack on both.
    """
    measure, worst = measure_of(by), {}
    for defender, by_attack in table.items():
        met = played.get(defender, {})
        means = {a: float(np.mean(list(of.values()))) for a, of in by_attack.items() if of and a in met}
        if means:
            extreme = measure.worst(list(means.values()))
            worst[defender] = next(attack for attack, mean in means.items() if mean == extreme)
    return worst


def worst_values(
    by_attack: Mapping[str, Mapping[str, float]], measure: Measure, attack: str | None = None
) -> dict[str, tuple[float, str]]:
    """Scene by scene a defender's value under the attack that was screened for it, or else under the worst there."""
    if attack is None:
        return extremes(by_attack, measure.worst)
    return {scene: (value, attack) for scene, value in by_attack[attack].items()}


def mean_interval(found: Found, measure: Measure | None = None) -> Interval:
    """Mean over scenes, of a share unless the measure is something else."""
    values = [value for value, _ in found.values()]
    return share_interval(values) if measure is None else measure.interval_of(values)


def rank_defenders(
    tables: Mapping[str, Scores],
    informed: Collection[str] = (),
    *,
    by: str = "damage",
    screened: Mapping[str, str] | None = None,
) -> list[Ranking]:
    """Defenders by a measure under their worst attack, best first; `informed` ones last, unranked.

    Args:
        tables: scores by measure.
        informed: defenders that are given the attackers.
        by: the measure that ranks.
        screened: the attack that was screened for each defender. Every value is then under that one. Without it, each
            measure's value is under the attack that is worst in that measure, scene by scene.

    Returns:
        A line for each defender that has played and, if attacks were screened, has one.

    Raises:
        ValueError: an unknown measure.
    """
    found = {
        name: {
            m: worst_values(table[name], measure_of(m), None if screened is None else screened[name])
            for m, table in tables.items()
        }
        for name in _competing(tables[by], screened)
    }
    return _ranked(found, by, informed, lower_is_better=measure_of(by).lower_is_better)


def rank_attacks(tables: Mapping[str, Scores], informed: Collection[str] = (), *, by: str = "damage") -> list[Ranking]:
    """Attacks by what the best defence of each scene leaves, worst for it first; `informed` ones do not count."""
    turned = {m: _transposed({d: of[d] for d in of if d not in informed}) for m, of in tables.items()}
    found = {
        name: {m: extremes(turned[m][name], measure_of(m).best) for m in tables}
        for name, by_defender in turned[by].items()
        if any(by_defender.values())
    }
    return _ranked(found, by, (), lower_is_better=not measure_of(by).lower_is_better)


def compare_defenders(table: Scores, by: str, screened: Mapping[str, str] | None = None) -> list[Difference]:
    """Every pair of defenders over the same episodes, each under its own worst attack (see `rank_defenders`)."""
    measure = measure_of(by)
    values = {}
    for name in _competing(table, screened):
        found = worst_values(table[name], measure, None if screened is None else screened[name])
        values[name] = {scene: value for scene, (value, _) in found.items()}
    return compare(values)


def _competing(table: Scores, screened: Mapping[str, str] | None) -> list[str]:
    """The defenders that have played and, if attacks were screened, have one."""
    return [name for name, of in table.items() if any(of.values()) and (screened is None or name in screened)]


def _transposed(table: Scores) -> dict[str, dict[str, Mapping[str, float]]]:
    """Attack by defender instead of defender by attack."""
    turned: dict[str, dict[str, Mapping[str, float]]] = {}
    for defender, attacks in table.items():
        for attack, by_scene in attacks.items():
            turned.setdefault(attack, {})[defender] = by_scene
    return turned


def _ranked(
    found: Mapping[str, Mapping[str, Found]], by: str, informed: Collection[str], *, lower_is_better: bool
) -> list[Ranking]:
    """Lines in the order of the places; those that are given the attackers last."""
    numbers = {name: {scene: value for scene, (value, _) in of[by].items()} for name, of in found.items()}
    place = places({n: of for n, of in numbers.items() if n not in informed}, lower_is_better=lower_is_better)
    bounds = places({n: of for n, of in numbers.items() if n in informed}, lower_is_better=lower_is_better)
    made = []
    for name in (*place, *bounds):
        opponents = Counter(opponent for _, opponent in found[name][by].values())
        values = {m: mean_interval(of, measure_of(m)) for m, of in found[name].items() if of}
        at = place.get(name)
        made.append(Ranking(name, None if at is None else at.rank, by, values, tuple(opponents.most_common()), at))
    return made
