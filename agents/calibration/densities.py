"""Densities of similarities, from the comparisons of all groups: the part of a calibration that `bayes` rests on.

Histograms are smoothed by a Gaussian kernel over arcsin √s, which makes the variance of a share uniform. The kernel is
reflected at both ends. What a similarity says about the *number* of attackers differs from scene to scene. So each
density with attackers is mixed with the mean over their numbers. The density of the full view is that mean, because it
would otherwise be counted in every frame.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float
from scipy.stats import norm

from agents.calibration.comparisons import Episodes, Measurement, all_groups
from defenders.bayes.likelihood import attackers_in_groups, attackers_in_one, overlaps

EDGES = (0, 0.01, 0.04, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1)
FULL_VIEW_EDGES = (0, 0.02, 0.06, 0.15, 0.3, 0.45, 0.6, 0.8, 1)
WHAT = ("uncontaminated", "one_contaminated", "both_contaminated", "full_view")

Kind = tuple[str | int, ...]
"""One of

* ("uncontaminated", age, size, size of the reference, vehicles in both),
* ("one_contaminated", mode, size, attackers, size of the uncontaminated reference),
* ("both_contaminated", mode, size, size of the reference),
* ("full_view", mode, size, attackers, attackers in the full view).
"""
Values = dict[Kind, list[np.ndarray]]
Row = Float[np.ndarray, " _"]  # of two lengths: bins of a reference and of the full view


@dataclass(frozen=True, kw_only=True)
class Smoothing:
    """How histograms are smoothed.

    Attributes:
        bandwidth: of the kernel, rad.
        numbers: share of a density with attackers that is the mean over their numbers.
        tail: share of every density that is the mean of all.
    """

    bandwidth: float = 0.08
    numbers: float = 0.3
    tail: float = 0.005


def by_kind(measurements: Iterable[Measurement], episodes: Episodes) -> Values:
    """Similarities by kind of comparison."""
    values: Values = defaultdict(list)
    everyone, full_view = all_groups(episodes.n_vehicles), range(episodes.n_modes + 1)
    for measured in measurements:
        mode = 0 if not measured.attackers else 1 if measured.attack == episodes.loud else 2
        for (i, one), (j, other) in product(enumerate(everyone), enumerate(everyone)):
            now, then = len(one & measured.attackers), len(other & measured.attackers)
            # the reference is benign in the first attacked frame only
            first, later = measured.similarity[1:2, 0, i, j], measured.similarity[2:, 0, i, j]
            overlap = len(one), len(other), len(one & other)
            contaminated = "one_contaminated", mode, len(one), now, len(other)
            values[contaminated if now else ("uncontaminated", 1, *overlap)].append(first)
            if now and then:
                values["both_contaminated", mode, len(one), len(other)].append(later)
            elif now:
                values[contaminated].append(later)
            elif not then:
                values["uncontaminated", 1, *overlap].append(later)
            for age in range(1, 0 if measured.attackers else measured.similarity.shape[1]):
                values["uncontaminated", age + 1, *overlap].append(measured.similarity[age + 1 :, age, i, j])
        for i, one in enumerate(everyone[:-1]):
            for m in full_view if not mode else [mode]:
                values["full_view", m, len(one), len(one & measured.attackers), len(measured.attackers)].append(
                    measured.full_view[1:, i]
                )
    return values


def smoothed(values: list[np.ndarray], edges: Sequence[float], bandwidth: float) -> Row:
    """Probability of each bin."""
    x, inner = (np.arcsin(np.sqrt(np.clip(v, 0, 1))) for v in (np.concatenate(values), np.array(edges, dtype=float)))
    mirrored = np.concatenate([x, -x, np.pi - x])
    below = norm.cdf((inner[:, None] - mirrored[None]) / bandwidth).sum(1) / len(x)
    mass = np.diff(below)
    return mass / mass.sum()


def densities(values: Values, n_vehicles: int, smoothing: Smoothing) -> dict[Kind, Row]:
    """A histogram of every kind."""
    found = {
        kind: smoothed(of, FULL_VIEW_EDGES if kind[0] == "full_view" else EDGES, smoothing.bandwidth)
        for kind, of in values.items()
    }
    return {kind: _mixed(found, kind, n_vehicles, smoothing.numbers) for kind in found}


def _mixed(found: dict[Kind, Row], kind: Kind, n_vehicles: int, numbers: float) -> Row:
    """The density of a kind with attackers, mixed with the mean over their numbers."""
    if kind[0] == "one_contaminated":
        similar = [row for other, row in found.items() if other[:3] == kind[:3] and other[4] == kind[4]]
        share = 1.0 if kind[2] == n_vehicles else numbers
    elif kind[0] == "full_view" and kind[4]:
        similar = [row for k, row in found.items() if k[:3] == kind[:3] and k[4] and bool(k[3]) == bool(kind[3])]
        share = numbers
    else:
        return found[kind]
    row: Row = (1 - share) * found[kind] + share * np.mean(similar, axis=0)
    return row


def part_of(found: dict[Kind, Row], episodes: Episodes, tail: float) -> dict[str, object]:
    """What `defenders.bayes.histograms.likelihood_of` reads."""
    n, listed = episodes.n_vehicles, {kind: row.round(5).tolist() for kind, row in found.items()}
    sizes, modes = range(1, n + 1), range(1, episodes.n_modes + 1)
    return {
        "n_vehicles": n,
        "edges": list(EDGES),
        "tail": tail,
        "uncontaminated": [
            [listed["uncontaminated", age, *kind] for kind in overlaps(n)] for age in range(1, episodes.ages + 1)
        ],
        "one_contaminated": [
            [listed["one_contaminated", m, s, min(d, n - 1), other] for s, d, other in attackers_in_one(n)]
            for m in modes
        ],
        "both_contaminated": [[listed["both_contaminated", m, *kind] for kind in product(sizes, sizes)] for m in modes],
        "full_view_edges": list(FULL_VIEW_EDGES),
        "full_view": [[listed["full_view", m, *kind] for kind in attackers_in_groups(n)] for m in modes],
    }


def left_out(measurements: Sequence[Measurement], episodes: Episodes, smoothing: Smoothing) -> dict[str, float]:
    """Mean log-likelihood of each scene's similarities under the densities of the others.

    All kinds and scenes have the same weight.
    """
    scores: dict[str, list[float]] = defaultdict(list)
    for scene in sorted({one.scene for one in measurements}):
        others = by_kind((one for one in measurements if one.scene != scene), episodes)
        known = densities(others, episodes.n_vehicles, smoothing)
        mean = {what: np.mean([row for kind, row in known.items() if kind[0] == what], axis=0) for what in WHAT}
        for kind, values in by_kind((one for one in measurements if one.scene == scene), episodes).items():
            edges = np.array(FULL_VIEW_EDGES if kind[0] == "full_view" else EDGES)[1:-1]
            row = (1 - smoothing.tail) * known[kind] + smoothing.tail * mean[str(kind[0])]
            bins = np.searchsorted(edges, np.concatenate(values), side="right")
            scores[str(kind[0])].append(float(np.log(row[bins]).mean()))
    return {what: float(np.mean(scores[what])) for what in WHAT}
