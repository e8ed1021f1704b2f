"""Densities of similarities as they were measured: a file of histograms for a fusion."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from defenders.bayes.likelihood import Likelihood, Row, Verifier, liars_in_groups, liars_in_one, overlaps

CALIBRATED = Path(__file__).with_name("densities")
DEFAULT = "mean"
"""The fusion whose densities serve until a defender is told of another, and for one that has no file."""
FADES = 0.95  # what a reference older than was measured keeps of its power with every frame


class Calibrated(Likelihood):
    """Densities measured on calibration scenes, with heavy tails, for fleets of any size.

    Of every density a share `tail` is replaced by the mean of all: no similarity, however odd, speaks for one kind of
    comparison against another by more than a bounded ratio. Where nothing was measured:

    * a clean view of more vehicles than measured counts as one of the most measured, sharing as large a part; so does
      what a lie is compared with;
    * beside the free view of as many vehicles as were not measured, sizes and numbers of liars count in proportion;
    * d liars among more vehicles than measured, m, count as d m / size among m, rounded; where that is below one, the
      lie may be too dilute to show: so much of the density of one liar among m, and the rest of none;
    * lies of one manner beside lies of another resemble each other as those of the first do.
    """

    def __init__(
        self,
        edges: Float[np.ndarray, " E"],
        clean: Sequence[Mapping[tuple[int, int, int], Row]],
        dirty: Sequence[Mapping[tuple[int, int, int], Row]],
        both: Sequence[Mapping[tuple[int, int], Row]],
        beside_edges: Float[np.ndarray, " F"],
        beside: Sequence[Mapping[tuple[int, int, int], Float[np.ndarray, " C"]]],
        *,
        tail: float,
    ) -> None:
        """Histograms, else ValueError: `clean[age - 1][size, reference, shared]`, and for each manner of lies
        `dirty[manner - 1][size, liars, other]`, `both[…][size, other]` and `beside[…][size, liars, lying]`.
        """
        most = max((size for of in dirty for size, _, _ in of), default=0)
        for bounds in (edges, beside_edges):
            if not (bounds[0] == 0 and bounds[-1] == 1 and (np.diff(bounds) > 0).all()):
                raise ValueError(f"edges must rise from 0 to 1, got {bounds.tolist()}")
        if not 0 < tail < 1:
            raise ValueError(f"tail is the share of every density that is the mean of all, between 0 and 1, got {tail}")
        if not clean or any(set(of) != set(overlaps(most)) for of in clean):
            raise ValueError(f"honest views of every two groups of {most} vehicles must be measured; calibrate again")
        if not len(dirty) == len(both) == len(beside) or any(set(of) != set(liars_in_one(most)) for of in dirty):
            raise ValueError(f"any number of liars among {most} vehicles must be measured, in each manner")
        if any(set(of) != set(product(range(1, most + 1), repeat=2)) for of in both):
            raise ValueError(f"lies must be compared with lies for all sizes up to {most}; calibrate again")
        if any(set(of) != set(liars_in_groups(most)) for of in beside):
            raise ValueError(
                f"views of all groups of {most} vehicles beside that of all must be measured; calibrate again"
            )
        honest, lying = _stacked(clean), _stacked(dirty)
        for cells in (np.concatenate([honest, lying, _stacked(both)]), _stacked(beside)):
            if not (np.isfinite(cells).all() and (cells >= 0).all() and np.allclose(cells.sum(1), 1, atol=1e-3)):
                raise ValueError("every density must be a histogram that sums to one; calibrate again")
        self.edges, self.oldest, self.most, self.manners = edges, len(clean), most, len(dirty)
        self.tail, self.middle = tail, _normalised(honest.mean(0) + lying.mean(0))
        self._clean = [{kind: self._tailed(row, self.middle) for kind, row in of.items()} for of in clean]
        self._dirty = [{kind: self._tailed(row, self.middle) for kind, row in of.items()} for of in dirty]
        self._both = [{kind: self._tailed(row, self.middle) for kind, row in of.items()} for of in both]
        self.beside_edges, middle = beside_edges, _stacked(beside).mean(0)
        self._beside = [{kind: self._tailed(row, middle) for kind, row in of.items()} for of in beside]

    def clean(self, size: int, reference: int, shared: int, age: int) -> Row:
        one, other = min(size, self.most), min(reference, self.most)
        common = round(shared * min(one, other) / min(size, reference))
        common = max(common, one + other - self.most)
        return self._clean[min(age, self.oldest) - 1][one, other, common]

    def dirty(self, size: int, liars: int, other: int, manner: int = 1) -> Row:
        other = min(other, self.most)
        if size <= self.most:
            return self._dirty[manner - 1][size, liars, other]
        diluted = liars * self.most / size
        if diluted >= 1:
            return self.dirty(self.most, round(diluted), other, manner)
        none = self.clean(self.most, other, other, 1)
        return diluted * self.dirty(self.most, 1, other, manner) + (1 - diluted) * none

    def both(self, size: int, other: int, manner: int = 1, its: int = 1) -> Row:
        return self._both[min(manner, its) - 1][min(size, self.most), min(other, self.most)]

    def power(self, age: int) -> float:
        return super().power(age) * FADES ** max(age - self.oldest, 0)

    def beside(self, size: int, liars: int, everyone: int, lying: int, manner: int = 1) -> Row:
        share, known = self.most / everyone, self._beside[manner - 1]
        one = min(max(round(size * share), 1), self.most - 1)
        all_lies = min(max(round(lying * share), int(lying > 0)), self.most - 1)
        if not liars:
            return known[one, 0, min(all_lies, self.most - one)]
        least, most = max(one + all_lies - self.most, 1), min(one, all_lies)
        return known[one, min(max(round(liars * share), least), most), all_lies]

    def worth(self, size: int, liars: int, manner: int = 1) -> float:
        """The mean of the density; beyond the sizes measured, what a clean view lacks shrinks as 1 / size."""
        middle = (self.edges[1:] + self.edges[:-1]) / 2
        if liars:
            return float(self.dirty(size, liars, max(size, self.most), manner) @ middle)
        lack = 1 - float(self.clean(size, max(size, self.most), size, 1) @ middle)
        return 1 - lack * min(1.0, self.most / size)

    def _tailed(self, row: Row, middle: Row) -> Row:
        return _normalised((1 - self.tail) * row + self.tail * middle)


def _normalised(row: Row) -> Row:
    return row / row.sum()


def _stacked(densities: Sequence[Mapping[Any, Row]]) -> Float[np.ndarray, "R B"]:
    return np.array([row for of in densities for row in of.values()])


def open_likelihood(likelihood: str | Likelihood, fusion: str = DEFAULT) -> Likelihood:
    """`"calibrated"`: the shipped densities of a fusion; `"perfect"`: a yes/no world; or a finished likelihood."""
    if isinstance(likelihood, Likelihood):
        return likelihood
    if likelihood == "perfect":
        return Verifier()
    if likelihood == "calibrated":
        path = CALIBRATED / f"{fusion}.json"
        return read_likelihood(path if path.exists() else CALIBRATED / f"{DEFAULT}.json")
    raise ValueError(f'likelihood must be "calibrated", "perfect" or a Likelihood, got {likelihood!r}')


def read_likelihood(path: Path) -> Calibrated:
    """Read what `examples/calibrate_likelihood.py` writes; ValueError naming the file where it is missing or broken."""
    try:
        stored: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        n = int(stored["n_vehicles"])

        def by_kind(name: str, kinds: Sequence[Any]) -> list[dict[Any, Row]]:
            return [dict(zip(kinds, np.array(of, dtype=float), strict=True)) for of in stored[name]]

        return Calibrated(
            np.array(stored["edges"], dtype=float),
            by_kind("clean", overlaps(n)),
            by_kind("dirty", liars_in_one(n)),
            by_kind("both", list(product(range(1, n + 1), repeat=2))),
            np.array(stored["beside_edges"], dtype=float),
            by_kind("beside", liars_in_groups(n)),
            tail=float(stored["tail"]),
        )
    except FileNotFoundError as error:
        raise ValueError(f"no calibrated likelihood at {path}; write it with calibrate_likelihood.py") from error
    except (json.JSONDecodeError, KeyError, IndexError, TypeError, AttributeError, ValueError) as error:
        raise ValueError(f"broken likelihood file {path}: {error!r}; restore it or calibrate again") from error
