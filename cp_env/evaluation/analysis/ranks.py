"""How sure a rank is: the probability of being first, and the places that an entry cannot be told apart from.

The probability is the share of resampled sets of scenes in which the entry comes first; all entries are resampled
together, since they played the same episodes. The places follow from the paired comparisons of all entries (see
`comparisons`): an entry's best place comes after those that are better beyond chance, its worst one before those that
are worse. Both ends hold for all entries at once with 95 %, as far as the paired tests do.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from cp_env.evaluation.analysis.comparisons import Difference, compare

RESAMPLES = 10_000
SEED = 0
CLOSE = 1e-12


@dataclass(frozen=True)
class Place:
    """An entry's place among others."""

    rank: int  # by the mean, 1 is the best
    low: int  # the best place that the scenes allow
    high: int  # the worst one
    first: float | None  # probability of being first; None from a single scene

    def __str__(self) -> str:
        return str(self.rank) if self.low == self.high else f"{self.low}–{self.high}"


def places(values: Mapping[str, Mapping[str, float]], *, lower_is_better: bool) -> dict[str, Place]:
    """The place of each entry, best first; of equal means the first named is ahead.

    Args:
        values: by entry and scene.
        lower_is_better: which way the values go.

    Returns:
        Places by entry.

    Raises:
        ValueError: entries of different scenes.
    """
    sign = 1 if lower_is_better else -1
    costs = {name: sign * float(np.mean(list(of.values()))) for name, of in values.items()}
    order = sorted(costs, key=lambda name: costs[name])
    first = first_probabilities(values, lower_is_better=lower_is_better)
    ahead, behind = dict.fromkeys(values, 0), dict.fromkeys(values, 0)
    for pair in compare(values):
        if pair.told_apart:
            better, worse = _ordered(pair, sign)
            ahead[worse] += 1
            behind[better] += 1
    return {
        name: Place(1 + i, 1 + ahead[name], len(order) - behind[name], None if first is None else first[name])
        for i, name in enumerate(order)
    }


def first_probabilities(
    values: Mapping[str, Mapping[str, float]], *, lower_is_better: bool, resamples: int = RESAMPLES, seed: int = SEED
) -> dict[str, float] | None:
    """The share of resampled sets of scenes in which each entry is first; entries that tie share it. They sum to 1.

    Args:
        values: by entry and scene.
        lower_is_better: which way the values go.
        resamples: of the scenes, the same for all entries.
        seed: of them.

    Returns:
        Probabilities by entry; None where nothing can be said, from a single scene or none.

    Raises:
        ValueError: entries of different scenes.
    """
    scenes = list(next(iter(values.values()), {}))
    if any(of.keys() != set(scenes) for of in values.values()):
        raise ValueError("the probability of being first needs the same scenes of every entry")
    if len(scenes) < 2:
        return None
    table = np.array([[of[scene] for scene in scenes] for of in values.values()])  # [N, S]
    times = np.random.default_rng(seed).multinomial(len(scenes), np.full(len(scenes), 1 / len(scenes)), resamples)
    means = (1 if lower_is_better else -1) * (times @ table.T) / len(scenes)  # [B, N]
    wins = means <= means.min(axis=1, keepdims=True) + CLOSE
    shares = (wins / wins.sum(axis=1, keepdims=True)).mean(axis=0)
    return dict(zip(values, shares.tolist(), strict=True))


def _ordered(pair: Difference, sign: int) -> tuple[str, str]:
    """The better and the worse entry of a pair."""
    return (pair.first, pair.second) if sign * pair.interval.mean < 0 else (pair.second, pair.first)
