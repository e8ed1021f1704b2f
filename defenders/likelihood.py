"""How probable is a similarity, given how many vehicles were fused and how many of them lied?

A *comparison* is the similarity, Eq. (5), of a group's view to a reference: an earlier view of some group. Its density
depends on the sizes of both, on how many liars were at work in each, and on how old the reference is. A group's view
is also compared with the free one of the same frame, of everyone present: *beside* it. Where liars are at work that one
is a lie, which the views of those who tell it resemble and the views of others do not, whatever any reference is worth.
Similarities are binned, so a density is a row of probabilities, one for each bin.
"""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

CALIBRATED = Path(__file__).with_name("likelihood.json")
GLITCH, BOTH = 0, 1  # the first two rows of every table
Row = Float[np.ndarray, " B"]
Counts = Int[np.ndarray, "..."]


class Likelihood(ABC):
    """Densities of the similarity of a view to a reference. `edges` bound the bins, from 0 to 1."""

    edges: Float[np.ndarray, " E"]
    beside_edges: Float[np.ndarray, " F"]  # of the bins of a similarity to the free view
    oldest: int  # frames; an older reference counts as one of this age

    @abstractmethod
    def clean(self, size: int, reference: int, shared: int, age: int) -> Row:
        """Nobody lies in the view of `size` vehicles, nor in the reference of `reference`, `shared` of them the same.

        The reference is `age` frames old.
        """

    @abstractmethod
    def dirty(self, size: int, liars: int) -> Row:
        """`liars` of `size` vehicles lie in one of the two views compared, nobody in the other."""

    @abstractmethod
    def both(self) -> Row:
        """Somebody lies in both."""

    @abstractmethod
    def glitch(self) -> Row:
        """Anything may have happened."""

    @abstractmethod
    def beside(self, size: int, liars: int, everyone: int, lying: int) -> Row:
        """Of a view of `size` vehicles, `liars` of which lie, to the free one of `everyone`, `lying` of which do."""

    @abstractmethod
    def worth(self, size: int, liars: int) -> float:
        """What a view is good for, in [0, 1]: its expected similarity to what an honest ego would see."""

    def power(self, age: int) -> float:
        """How well a reference of this age tells a liar: total variation of what one liar and none show."""
        one, none = self.dirty(1, 1), self.clean(1, 1, 1, age)
        return float(np.abs(one - none).sum() / 2)

    def bin(self, similarity: float, *, beside: bool = False) -> int:
        """The bin a similarity falls into; those outside [0, 1] fall into the first or the last."""
        edges = self.beside_edges if beside else self.edges
        return int(np.searchsorted(edges[1:-1], similarity, side="right"))

    def tables(self, n: int) -> tuple[Table, ...]:
        """The densities for a fleet of `n`, for references of age 1, 2, …, `oldest`."""
        return tuple(Table(self, n, age) for age in range(1, self.oldest + 1))


class Table:
    """All densities a fleet of `n` can meet, as rows, and which row a comparison belongs to."""

    def __init__(self, likelihood: Likelihood, n: int, age: int) -> None:
        rows = [likelihood.glitch(), likelihood.both()]
        self._clean = np.zeros((n + 1, n + 1, n + 1), dtype=np.int64)
        self._dirty = np.zeros((n + 1, n + 1), dtype=np.int64)
        known: dict[bytes, int] = {}
        for size, other in product(range(1, n + 1), repeat=2):
            for shared in range(max(size + other - n, 0), min(size, other) + 1):
                row = likelihood.clean(size, other, shared, age)
                if row.tobytes() not in known:
                    known[row.tobytes()] = len(rows)
                    rows.append(row)
                self._clean[size, other, shared] = known[row.tobytes()]
        for size in range(1, n + 1):
            for liars in range(1, size + 1):
                self._dirty[size, liars] = len(rows)
                rows.append(likelihood.dirty(size, liars))
        self.density: Float[np.ndarray, "R B"] = np.array(rows)

    def rows(
        self, size: int | Counts, liars: Counts, reference: int, its_liars: Counts, shared: int | Counts
    ) -> Counts:
        """Rows of `density`, given liars at work in the view and in the reference; -1 liars stand for a glitch."""
        one = np.where(liars == 0, self._dirty[reference, its_liars], self._dirty[size, liars])
        row = np.where((liars == 0) & (its_liars == 0), self._clean[size, reference, shared], one)
        row = np.where((liars > 0) & (its_liars > 0), BOTH, row)
        return np.where((liars < 0) | (its_liars < 0), GLITCH, row)


class BesideTable:
    """All densities of a similarity to the free view of `everyone`, as rows, and which row belongs to a group."""

    def __init__(self, likelihood: Likelihood, everyone: int) -> None:
        rows: list[Row] = []
        self._row = np.zeros((everyone + 1, everyone + 1, everyone + 1), dtype=np.int64)
        for lying, size in product(range(everyone + 1), range(1, everyone + 1)):
            for liars in range(max(size + lying - everyone, 0), min(size, lying) + 1):
                self._row[size, liars, lying] = len(rows)
                rows.append(likelihood.beside(size, liars, everyone, lying))
        self._glitch = len(rows)
        self.density: Float[np.ndarray, "R B"] = np.array([*rows, np.mean(rows, axis=0)])

    def rows(self, size: int | Counts, liars: Counts, lying: Counts) -> Counts:
        """Rows of `density`; -1 lying stand for a glitch."""
        return np.where(lying < 0, self._glitch, self._row[size, np.maximum(liars, 0), np.maximum(lying, 0)])


@dataclass(frozen=True, eq=False)
class Verifier(Likelihood):
    """A yes/no world: alike (1) when nobody lies in either view, else not (0), with the given rates of error.

    A view of a larger clean group is worth a little more, as it sees more: 1 - 1 / (2 size).
    """

    false_fail: float = 1e-3  # an honest group fails
    false_pass: float = 1e-3  # a group with a liar passes

    def __post_init__(self) -> None:
        for name in ("false_fail", "false_pass"):
            if not 0 < getattr(self, name) < 0.5:
                raise ValueError(f"{name} is a rate of error between 0 and 0.5, got {getattr(self, name)}; try 1e-3")

    edges = np.array([0.0, 0.5, 1.0])
    beside_edges = np.array([0.0, 1.0])
    oldest = 1

    def clean(self, size: int, reference: int, shared: int, age: int) -> Row:
        return np.array([self.false_fail, 1 - self.false_fail])

    def dirty(self, size: int, liars: int) -> Row:
        return np.array([1 - self.false_pass, self.false_pass])

    def both(self) -> Row:
        return self.dirty(1, 1)

    def glitch(self) -> Row:
        return np.array([0.5, 0.5])

    def beside(self, size: int, liars: int, everyone: int, lying: int) -> Row:
        """One bin: nothing resembles a lie here, and what an honest view errs it errs against any other too."""
        return np.ones(1)

    def worth(self, size: int, liars: int) -> float:
        return 0.0 if liars else 1 - 0.5 / size


class Calibrated(Likelihood):
    """Densities measured on calibration scenes, with heavy tails, for fleets of any size.

    Of every density a share `tail` is replaced by the mean of all: no similarity, however odd, speaks for one kind of
    comparison against another by more than a bounded ratio. Where nothing was measured:

    * a clean view of more vehicles than measured counts as one of the most measured, sharing as large a part;
    * beside the free view of as many vehicles as were not measured, sizes and numbers of liars count in proportion;
    * more liars than measured in a group of a measured size count as the most measured;
    * d liars among more vehicles than measured, m, count as d m / size among m, rounded; where that is below one, the
      lie may be too dilute to show: so much of the density of one liar among m, and the rest of none.
    """

    def __init__(
        self,
        edges: Float[np.ndarray, " E"],
        clean: Sequence[Mapping[tuple[int, int, int], Row]],
        dirty: Mapping[tuple[int, int], Row],
        both: Row,
        beside_edges: Float[np.ndarray, " F"],
        beside: Mapping[tuple[int, int, int], Float[np.ndarray, " C"]],
        *,
        tail: float,
    ) -> None:
        """Histograms, else ValueError: `clean[age - 1][size, reference, shared]`, `dirty[size, liars]` and
        `beside[size, liars, lying]`.
        """
        most = max((size for size, _ in dirty), default=0)
        for bounds in (edges, beside_edges):
            if not (bounds[0] == 0 and bounds[-1] == 1 and (np.diff(bounds) > 0).all()):
                raise ValueError(f"edges must rise from 0 to 1, got {bounds.tolist()}")
        if missing := [size for size in range(1, most + 1) if (size, 1) not in dirty]:
            raise ValueError(f"one liar in a group must be measured for every size, but is missing for {missing}")
        if not 0 < tail < 1:
            raise ValueError(f"tail is the share of every density that is the mean of all, between 0 and 1, got {tail}")
        if not clean or any(set(of) != set(overlaps(most)) for of in clean):
            raise ValueError(f"honest views of every two groups of {most} vehicles must be measured; calibrate again")
        if set(beside) != set(liars_in_groups(most)):
            raise ValueError(
                f"views of all groups of {most} vehicles beside that of all must be measured; calibrate again"
            )
        honest, lying = np.array([list(of.values()) for of in clean]), np.array(list(dirty.values()))
        for cells in (np.concatenate([honest.reshape(-1, len(both)), lying, both[None]]), np.array([*beside.values()])):
            if not (np.isfinite(cells).all() and (cells >= 0).all() and np.allclose(cells.sum(1), 1, atol=1e-3)):
                raise ValueError("every density must be a histogram that sums to one; calibrate again")
        self.edges, self.oldest, self.most = edges, len(clean), most
        kinds = [honest.mean((0, 1)), lying.mean(0)]
        self._mean = np.mean(kinds, axis=0) / np.sum(np.mean(kinds, axis=0))
        self.tail = tail
        self._clean = [{kind: self._tailed(row) for kind, row in of.items()} for of in clean]
        self._dirty, self._both = {kind: self._tailed(row) for kind, row in dirty.items()}, self._tailed(both)
        self.beside_edges, middle = beside_edges, np.mean([*beside.values()], axis=0)
        tailed = {kind: (1 - tail) * row + tail * middle for kind, row in beside.items()}
        self._beside = {kind: row / row.sum() for kind, row in tailed.items()}

    def clean(self, size: int, reference: int, shared: int, age: int) -> Row:
        one, other = min(size, self.most), min(reference, self.most)
        common = round(shared * min(one, other) / min(size, reference))
        common = max(common, one + other - self.most)
        return self._clean[min(age, self.oldest) - 1][one, other, common]

    def dirty(self, size: int, liars: int) -> Row:
        if size <= self.most:
            return self._dirty[size, max(d for s, d in self._dirty if s == size and d <= liars)]
        diluted = liars * self.most / size
        if diluted >= 1:
            return self.dirty(self.most, round(diluted))
        return diluted * self.dirty(self.most, 1) + (1 - diluted) * self.clean(self.most, self.most, self.most, 1)

    def both(self) -> Row:
        return self._both

    def glitch(self) -> Row:
        return self._mean

    def beside(self, size: int, liars: int, everyone: int, lying: int) -> Row:
        share = self.most / everyone
        one = min(max(round(size * share), 1), self.most - 1)
        all_lies = min(max(round(lying * share), int(lying > 0)), self.most - 1)
        if not liars:
            return self._beside[one, 0, min(all_lies, self.most - one)]
        least, most = max(one + all_lies - self.most, 1), min(one, all_lies)
        return self._beside[one, min(max(round(liars * share), least), most), all_lies]

    def worth(self, size: int, liars: int) -> float:
        """The mean of the density; beyond the sizes measured, what a clean view lacks shrinks as 1 / size."""
        middle = (self.edges[1:] + self.edges[:-1]) / 2
        if liars:
            return float(self.dirty(size, liars) @ middle)
        lack = 1 - float(self.clean(size, max(size, self.most), size, 1) @ middle)
        return 1 - lack * min(1.0, self.most / size)

    def _tailed(self, row: Row) -> Row:
        mixed = (1 - self.tail) * row + self.tail * self._mean
        return mixed / mixed.sum()


def overlaps(n: int) -> list[tuple[int, int, int]]:
    """Sizes of two groups among n vehicles, and of what they share."""
    return [
        (one, other, shared)
        for one, other in product(range(1, n + 1), repeat=2)
        for shared in range(max(one + other - n, 0), min(one, other) + 1)
    ]


def liars_in_groups(n: int) -> list[tuple[int, int, int]]:
    """Sizes of groups smaller than n, liars in them, and liars among all n, who are at most n - 1."""
    return [
        (size, liars, lying)
        for lying, size in product(range(n), range(1, n))
        for liars in range(max(size + lying - n, 0), min(size, lying) + 1)
    ]


def open_likelihood(likelihood: str | Likelihood) -> Likelihood:
    """`"calibrated"`: the shipped file; `"perfect"`: a yes/no world; or a finished likelihood."""
    if isinstance(likelihood, Likelihood):
        return likelihood
    if likelihood == "perfect":
        return Verifier()
    if likelihood == "calibrated":
        return read_likelihood(CALIBRATED)
    raise ValueError(f'likelihood must be "calibrated", "perfect" or a Likelihood, got {likelihood!r}')


def read_likelihood(path: Path) -> Calibrated:
    """Read what `examples/calibrate_likelihood.py` writes; ValueError naming the file where it is missing or broken."""
    try:
        stored: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        dirty = {(int(s), int(d)): np.array(row) for s, of in stored["dirty"].items() for d, row in of.items()}
        edges, both = (np.array(stored[name], dtype=float) for name in ("edges", "both"))
        kinds = overlaps(max(size for size, _ in dirty))
        clean = [dict(zip(kinds, np.array(of, dtype=float), strict=True)) for of in stored["clean"]]
        groups = liars_in_groups(max(size for size, _ in dirty))
        beside_edges = np.array(stored["beside_edges"], dtype=float)
        beside = dict(zip(groups, np.array(stored["beside"], dtype=float), strict=True))
        return Calibrated(edges, clean, dirty, both, beside_edges, beside, tail=float(stored["tail"]))
    except FileNotFoundError as error:
        raise ValueError(f"no calibrated likelihood at {path}; write it with calibrate_likelihood.py") from error
    except (json.JSONDecodeError, KeyError, IndexError, TypeError, AttributeError, ValueError) as error:
        raise ValueError(f"broken likelihood file {path}: {error!r}; restore it or calibrate again") from error
