"""How probable is a similarity, given how many vehicles were fused and how many of them lied?

A *comparison* is the similarity, Eq. (5), of a group's view to a reference: an earlier view of some group. Its density
depends on the sizes of both, on how many liars were at work in each, and on how old the reference is. A group's view
is also compared with the free one of the same frame, of everyone present: *beside* it. Where liars are at work that one
is a lie, which the views of those who tell it resemble and the views of others do not, whatever any reference is worth.
Similarities are binned, so a density is a row of probabilities, one for each bin.

Lies have a *manner*, a number from 1 on. Those of the first show in any view they are in. Those of the second are made
to resemble the frame before: everyone's view gives nothing away, and only the views of those who do not lie do.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float, Int

ODD = 0.3  # of a glitch's density beside the free view, the share in which its views do not even resemble each other

Row = Float[np.ndarray, " B"]
Counts = Int[np.ndarray, "..."]


class Likelihood(ABC):
    """Densities of the similarity of a view to a reference. `edges` bound the bins, from 0 to 1."""

    edges: Float[np.ndarray, " E"]
    beside_edges: Float[np.ndarray, " F"]  # of the bins of a similarity to the free view
    oldest: int  # frames; an older reference counts as one of this age
    most: int  # vehicles; what is compared with a larger view counts as compared with one of so many
    manners: int = 1  # of lies

    @abstractmethod
    def clean(self, size: int, reference: int, shared: int, age: int) -> Row:
        """Nobody lies in the view of `size` vehicles, nor in the reference of `reference`, `shared` of them the same.

        The reference is `age` frames old.
        """

    @abstractmethod
    def dirty(self, size: int, liars: int, other: int, manner: int = 1) -> Row:
        """`liars` of `size` vehicles lie in one of the two views compared, nobody in the other, of `other` vehicles."""

    @abstractmethod
    def both(self, size: int, other: int, manner: int = 1, its: int = 1) -> Row:
        """Somebody lies in both, of `size` and `other` vehicles, in this manner and in `its`."""

    @abstractmethod
    def beside(self, size: int, liars: int, everyone: int, lying: int, manner: int = 1) -> Row:
        """Of a view of `size` vehicles, `liars` of which lie, to the free one of `everyone`, `lying` of which do."""

    @abstractmethod
    def worth(self, size: int, liars: int, manner: int = 1) -> float:
        """What a view is good for, in [0, 1]: its expected similarity to what an honest ego would see."""

    def glitch(self, size: int, other: int, manner: int = 1) -> Row:
        """Nobody lies, and yet lies seem to show, whoever is in the two views: as if liars were drawn anew each time.

        Sizes are of at most `most` vehicles.
        """
        shared = range(max(size + other - self.most, 0), min(size, other) + 1)
        kinds = [
            [self.clean(size, other, both, 1) for both in shared],
            [self.dirty(size, liars, other, manner) for liars in range(1, size + 1)],
            [self.dirty(other, liars, size, manner) for liars in range(1, other + 1)],
            [self.both(size, other, manner, manner)],
        ]
        row: Row = np.mean([np.mean(rows, axis=0) for rows in kinds], axis=0)
        return row

    def power(self, age: int) -> float:
        """How well a reference of this age tells a liar: total variation of what one liar and none show."""
        one, none = self.dirty(1, 1, 1), self.clean(1, 1, 1, age)
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
        self._rows: list[Row] = []
        self._known: dict[bytes, int] = {}
        self._most = most = min(n, likelihood.most)
        self.manners = manners = likelihood.manners
        self._glitch = np.zeros((manners + 1, most + 1, most + 1), dtype=np.int64)
        self._clean = np.zeros((n + 1, n + 1, n + 1), dtype=np.int64)
        self._dirty = np.zeros((manners + 1, n + 1, n + 1, most + 1), dtype=np.int64)
        self._both = np.zeros((manners + 1, manners + 1, most + 1, most + 1), dtype=np.int64)
        for size, other, shared in overlaps(n):
            self._clean[size, other, shared] = self._add(likelihood.clean(size, other, shared, age))
        of_lies, one_of_most = range(1, manners + 1), range(1, most + 1)
        for manner, size, other in product(of_lies, range(1, n + 1), one_of_most):
            for liars in range(1, size + 1):
                self._dirty[manner, size, liars, other] = self._add(likelihood.dirty(size, liars, other, manner))
        for manner, size, other in product(of_lies, one_of_most, one_of_most):
            self._glitch[manner, size, other] = self._add(likelihood.glitch(size, other, manner))
        for manner, its, size, other in product(of_lies, of_lies, one_of_most, one_of_most):
            self._both[manner, its, size, other] = self._add(likelihood.both(size, other, manner, its))
        self.density: Float[np.ndarray, "R B"] = np.array(self._rows)
        self.entropy = entropy(self.density)

    def _add(self, row: Row) -> int:
        if (key := row.tobytes()) not in self._known:
            self._known[key] = len(self._rows)
            self._rows.append(row)
        return self._known[key]

    def rows(
        self,
        size: int | Counts,
        liars: Counts,
        reference: int,
        its_liars: Counts,
        shared: int | Counts,
        manner: int | Counts = 1,
        its_manner: int | Counts = 1,
    ) -> Counts:
        """Rows of `density`, given liars at work in the view and in the reference, and the manner of the lies in each.

        -1 liars stand for a glitch.
        """
        one, other = np.minimum(size, self._most), min(reference, self._most)
        row = np.where(
            liars > 0, self._dirty[manner, size, liars, other], self._dirty[its_manner, reference, its_liars, one]
        )
        row = np.where((liars == 0) & (its_liars == 0), self._clean[size, reference, shared], row)
        row = np.where((liars > 0) & (its_liars > 0), self._both[manner, its_manner, one, other], row)
        glitch = self._glitch[np.where(liars < 0, manner, its_manner), one, other]
        return np.where((liars < 0) | (its_liars < 0), glitch, row)


class BesideTable:
    """All densities of a similarity to the free view of `everyone`, as rows, and which row belongs to a group."""

    def __init__(self, likelihood: Likelihood, everyone: int) -> None:
        rows: list[Row] = []
        self.manners = manners = likelihood.manners
        self._row = np.zeros((manners + 1, everyone + 1, everyone + 1, everyone + 1), dtype=np.int64)
        self._glitch = np.zeros((manners + 1, everyone + 1), dtype=np.int64)
        for manner, size in product(range(1, manners + 1), range(1, everyone + 1)):
            first = len(rows)
            for lying in range(everyone + 1):
                for liars in range(max(size + lying - everyone, 0), min(size, lying) + 1):
                    self._row[manner, size, liars, lying] = len(rows)
                    rows.append(likelihood.beside(size, liars, everyone, lying, manner))
            self._glitch[manner, size] = len(rows)
            rows.append((1 - ODD) * rows[first] + ODD * np.mean(rows[first:], axis=0))
        self.density: Float[np.ndarray, "R B"] = np.array(rows)
        self.entropy = entropy(self.density)

    def rows(self, size: int | Counts, liars: Counts, lying: Counts, manner: int | Counts = 1) -> Counts:
        """Rows of `density`; -1 lying stand for a glitch."""
        manner = np.maximum(manner, 1)
        row = self._row[manner, size, np.maximum(liars, 0), np.maximum(lying, 0)]
        return np.where(lying < 0, self._glitch[manner, size], row)


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
    oldest = most = 1

    def clean(self, size: int, reference: int, shared: int, age: int) -> Row:
        return np.array([self.false_fail, 1 - self.false_fail])

    def dirty(self, size: int, liars: int, other: int, manner: int = 1) -> Row:
        return np.array([1 - self.false_pass, self.false_pass])

    def both(self, size: int, other: int, manner: int = 1, its: int = 1) -> Row:
        return self.dirty(1, 1, 1)

    def beside(self, size: int, liars: int, everyone: int, lying: int, manner: int = 1) -> Row:
        """One bin: nothing resembles a lie here, and what an honest view errs it errs against any other too."""
        return np.ones(1)

    def worth(self, size: int, liars: int, manner: int = 1) -> float:
        return 0.0 if liars else 1 - 0.5 / size


def entropy(p: np.ndarray, axis: int | tuple[int, ...] = -1) -> np.ndarray:
    """In bits; 0 log 0 is 0."""
    bits: np.ndarray = -(p * np.log2(np.maximum(p, 1e-300))).sum(axis)
    return bits


def overlaps(n: int) -> list[tuple[int, int, int]]:
    """Sizes of two groups among n vehicles, and of what they share."""
    return [
        (one, other, shared)
        for one, other in product(range(1, n + 1), repeat=2)
        for shared in range(max(one + other - n, 0), min(one, other) + 1)
    ]


def liars_in_one(n: int) -> list[tuple[int, int, int]]:
    """Size of a group among n vehicles, liars in it, and size of an honest one that it is compared with."""
    return [(size, liars, other) for size, other in product(range(1, n + 1), repeat=2) for liars in range(1, size + 1)]


def liars_in_groups(n: int) -> list[tuple[int, int, int]]:
    """Sizes of groups smaller than n, liars in them, and liars among all n, who are at most n - 1."""
    return [
        (size, liars, lying)
        for lying, size in product(range(n), range(1, n))
        for liars in range(max(size + lying - n, 0), min(size, lying) + 1)
    ]
