"""Densities of the similarity of two views, given how many vehicles were fused and how many of them attacked.

A *comparison* is the similarity, Eq. (5), of a group's view to a reference: an earlier view of some group. Its density
depends on the sizes of both groups, on the number of active attackers in each, and on the age of the reference. A view
is *contaminated* if an active attacker is in its group.

A group's view is also compared with the *full view* of the same frame, of everyone present. While attackers are active
the full view is contaminated. Contaminated views resemble it and uncontaminated views do not, whatever any reference
is worth. Similarities are binned, so a density is a row of probabilities, one for each bin.

Attacks have a *mode*, a number from 1 on. A loud attack (mode 1) shows in every view that contains it. A stealthy
attack (mode 2) keeps the full view similar to the frame before. Only uncontaminated views reveal it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float, Int

OUTLIER_MIX = 0.3
"""Share of an outlier's density against the full view in which not even views of the same frame resemble each other."""

Row = Float[np.ndarray, " B"]
Counts = Int[np.ndarray, "..."]


class Likelihood(ABC):
    """Densities of the similarity of a view to a reference. `edges` bound the bins, from 0 to 1."""

    edges: Float[np.ndarray, " E"]
    full_view_edges: Float[np.ndarray, " F"]  # of the bins of a similarity to the full view
    oldest: int  # frames; an older reference counts as one of this age
    most: int  # vehicles; what is compared with a larger view counts as compared with one of so many
    modes: int = 1  # of attack

    @abstractmethod
    def uncontaminated(self, size: int, reference: int, shared: int, age: int) -> Row:
        """Density where no attacker is active in either view.

        Args:
            size: Vehicles in the view.
            reference: Vehicles in the reference.
            shared: Vehicles in both.
            age: Frames between the reference and the view.

        Returns:
            A probability for each bin.
        """

    @abstractmethod
    def one_contaminated(self, size: int, attackers: int, other: int, mode: int = 1) -> Row:
        """Density where attackers are active in one of the two views.

        Args:
            size: Vehicles in the contaminated view.
            attackers: Active attackers among them.
            other: Vehicles in the uncontaminated view.
            mode: Mode of the attack.

        Returns:
            A probability for each bin.
        """

    @abstractmethod
    def both_contaminated(self, size: int, other: int, mode: int = 1, other_mode: int = 1) -> Row:
        """Density where attackers are active in both views.

        Args:
            size: Vehicles in the one view.
            other: Vehicles in the other view.
            mode: Mode of the attack in the one view.
            other_mode: Mode of the attack in the other view.

        Returns:
            A probability for each bin.
        """

    @abstractmethod
    def full_view(self, size: int, attackers: int, everyone: int, total_attackers: int, mode: int = 1) -> Row:
        """Density of the similarity of a group's view to the full view of the same frame.

        Args:
            size: Vehicles in the group.
            attackers: Active attackers in the group.
            everyone: Vehicles in the full view.
            total_attackers: Active attackers in the full view.
            mode: Mode of the attack.

        Returns:
            A probability for each bin of `full_view_edges`.
        """

    @abstractmethod
    def utility(self, size: int, attackers: int, mode: int = 1) -> float:
        """Utility of a view, in [0, 1]: its expected similarity to what an unattacked ego would perceive."""

    def outlier(self, size: int, other: int, mode: int = 1) -> Row:
        """Density of an outlier: nobody attacks, and yet an attack seems to show, whoever is in the two views.

        It is the density that results if the attackers were drawn anew for every comparison. Sizes are at most `most`.
        """
        shared = range(max(size + other - self.most, 0), min(size, other) + 1)
        kinds = [
            [self.uncontaminated(size, other, both, 1) for both in shared],
            [self.one_contaminated(size, attackers, other, mode) for attackers in range(1, size + 1)],
            [self.one_contaminated(other, attackers, size, mode) for attackers in range(1, other + 1)],
            [self.both_contaminated(size, other, mode, mode)],
        ]
        row: Row = np.mean([np.mean(rows, axis=0) for rows in kinds], axis=0)
        return row

    def discrimination(self, age: int) -> float:
        """Discrimination of a reference of this age: total variation between the densities of one attacker and none."""
        one, none = self.one_contaminated(1, 1, 1), self.uncontaminated(1, 1, 1, age)
        return float(np.abs(one - none).sum() / 2)

    def bin(self, similarity: float, *, full_view: bool = False) -> int:
        """The bin of a similarity. Values outside [0, 1] belong to the first or the last bin."""
        edges = self.full_view_edges if full_view else self.edges
        return int(np.searchsorted(edges[1:-1], similarity, side="right"))

    def tables(self, n: int) -> tuple[Table, ...]:
        """The densities for a fleet of `n`, for references of age 1, 2, …, `oldest`."""
        return tuple(Table(self, n, age) for age in range(1, self.oldest + 1))


class Table:
    """All densities that a fleet of `n` can meet, as rows, and the row of every comparison. Read-only."""

    def __init__(self, likelihood: Likelihood, n: int, age: int) -> None:
        found = _Rows()
        self._most = most = min(n, likelihood.most)
        self.modes = modes = likelihood.modes
        self._outlier = np.zeros((modes + 1, most + 1, most + 1), dtype=np.int32)
        self._uncontaminated = np.zeros((n + 1, n + 1, n + 1), dtype=np.int32)
        self._one_contaminated = np.zeros((modes + 1, n + 1, n + 1, most + 1), dtype=np.int32)
        self._both_contaminated = np.zeros((modes + 1, modes + 1, most + 1, most + 1), dtype=np.int32)
        for size, other, shared in overlaps(n):
            self._uncontaminated[size, other, shared] = found.add(likelihood.uncontaminated(size, other, shared, age))
        each_mode, one_of_most = range(1, modes + 1), range(1, most + 1)
        for mode, size, other in product(each_mode, range(1, n + 1), one_of_most):
            for attackers in range(1, size + 1):
                self._one_contaminated[mode, size, attackers, other] = found.add(
                    likelihood.one_contaminated(size, attackers, other, mode)
                )
        for mode, size, other in product(each_mode, one_of_most, one_of_most):
            self._outlier[mode, size, other] = found.add(likelihood.outlier(size, other, mode))
        for mode, other_mode, size, other in product(each_mode, each_mode, one_of_most, one_of_most):
            self._both_contaminated[mode, other_mode, size, other] = found.add(
                likelihood.both_contaminated(size, other, mode, other_mode)
            )
        self.density: Float[np.ndarray, "R B"] = found.stacked()
        self.entropy = read_only(entropy(self.density))
        for rows in (self._outlier, self._uncontaminated, self._one_contaminated, self._both_contaminated):
            read_only(rows)

    def rows(self, size: int, reference: int, shared: int) -> Int[np.ndarray, "A i A j"]:
        """Rows of `density` for comparisons of a view with a reference, whoever attacks.

        Args:
            size: Vehicles in the view.
            reference: Vehicles in the reference.
            shared: Vehicles in both.

        Returns:
            `rows[mode, attackers, reference_mode, reference_attackers]`, by the mode of the attack and the active
            attackers in the view, then in the reference. Mode 0 is no attack, whatever the number beside it. A number
            of -1 stands for an outlier.
        """
        one, other = min(size, self._most), min(reference, self._most)
        rows = np.empty((self.modes + 1, size + 2, self.modes + 1, reference + 2), dtype=np.int64)
        rows[:] = self._uncontaminated[size, reference, shared]
        rows[1:, 1:-1] = self._one_contaminated[1:, size, 1 : size + 1, other, None, None]
        rows[:, :, 1:, 1:-1] = self._one_contaminated[1:, reference, 1 : reference + 1, one]
        rows[1:, 1:-1, 1:, 1:-1] = self._both_contaminated[1:, None, 1:, None, one, other]
        rows[:, :, 1:, -1] = self._outlier[1:, one, other]
        rows[1:, -1] = self._outlier[1:, one, other, None, None]
        return rows


class FullViewTable:
    """All densities of a similarity to the full view of `everyone`, as rows, and the row of every group. Read-only."""

    def __init__(self, likelihood: Likelihood, everyone: int) -> None:
        found = _Rows()
        self.modes = modes = likelihood.modes
        self._row = np.zeros((modes + 1, everyone + 1, everyone + 1, everyone + 2), dtype=np.int32)
        for mode, size in product(range(1, modes + 1), range(1, everyone + 1)):
            rows = []
            for total_attackers in range(everyone + 1):
                for attackers in range(max(size + total_attackers - everyone, 0), min(size, total_attackers) + 1):
                    rows.append(likelihood.full_view(size, attackers, everyone, total_attackers, mode))
                    self._row[mode, size, attackers, total_attackers] = found.add(rows[-1])
            outlier = (1 - OUTLIER_MIX) * rows[0] + OUTLIER_MIX * np.mean(rows, axis=0)
            self._row[mode, size, :, -1] = found.add(outlier)
        self._row[0] = self._row[1, :, :1, :1]
        self.density: Float[np.ndarray, "R B"] = found.stacked()
        self.entropy = read_only(entropy(self.density))
        read_only(self._row)

    def rows(self, size: int | Counts, attackers: Counts, total_attackers: Counts, mode: int | Counts = 1) -> Counts:
        """Rows of `density`. `total_attackers` = -1 stands for an outlier, `mode` = 0 for no attack."""
        return np.asarray(self._row[mode, size, attackers, total_attackers])


class _Rows:
    """Rows, each of which is kept once."""

    def __init__(self) -> None:
        self._number: dict[bytes, int] = {}
        self._rows: list[Row] = []

    def add(self, row: Row) -> int:
        """The number of the row."""
        if (key := row.tobytes()) not in self._number:
            self._number[key] = len(self._rows)
            self._rows.append(row)
        return self._number[key]

    def stacked(self) -> Float[np.ndarray, "R B"]:
        """All rows, in the order of their numbers."""
        return read_only(np.array(self._rows))


def read_only(array: np.ndarray) -> np.ndarray:
    """The array, which from now on cannot be written to."""
    array.setflags(write=False)
    return array


@dataclass(frozen=True)
class Verifier(Likelihood):
    """Likelihood of a binary verifier: similar (1) if neither view is contaminated, else dissimilar (0), with errors.

    A larger uncontaminated group has a slightly higher utility, as it sees more: 1 - 1 / (2 size).
    """

    false_fail: float = 1e-3  # a benign group fails
    false_pass: float = 1e-3  # a group with an attacker passes

    def __post_init__(self) -> None:
        for name in ("false_fail", "false_pass"):
            if not 0 < getattr(self, name) < 0.5:
                raise ValueError(f"{name} is a rate of error between 0 and 0.5, got {getattr(self, name)}; try 1e-3")

    edges = read_only(np.array([0.0, 0.5, 1.0]))
    full_view_edges = read_only(np.array([0.0, 1.0]))
    oldest = most = 1

    def uncontaminated(self, size: int, reference: int, shared: int, age: int) -> Row:
        return np.array([self.false_fail, 1 - self.false_fail])

    def one_contaminated(self, size: int, attackers: int, other: int, mode: int = 1) -> Row:
        return np.array([1 - self.false_pass, self.false_pass])

    def both_contaminated(self, size: int, other: int, mode: int = 1, other_mode: int = 1) -> Row:
        return self.one_contaminated(1, 1, 1)

    def full_view(self, size: int, attackers: int, everyone: int, total_attackers: int, mode: int = 1) -> Row:
        """One bin: contaminated views do not resemble each other here, so the full view carries no information."""
        return np.ones(1)

    def utility(self, size: int, attackers: int, mode: int = 1) -> float:
        return 0.0 if attackers else 1 - 0.5 / size


def entropy(p: np.ndarray, axis: int | tuple[int, ...] = -1) -> np.ndarray:
    """Entropy in bits; 0 log 0 is 0."""
    bits: np.ndarray = -(p * np.log2(np.maximum(p, 1e-300))).sum(axis)
    return bits


def overlaps(n: int) -> list[tuple[int, int, int]]:
    """Sizes of two groups among n vehicles, and the number of vehicles in both."""
    return [
        (one, other, shared)
        for one, other in product(range(1, n + 1), repeat=2)
        for shared in range(max(one + other - n, 0), min(one, other) + 1)
    ]


def attackers_in_one(n: int) -> list[tuple[int, int, int]]:
    """Size of a group among n vehicles, active attackers in it, and size of an uncontaminated group to compare."""
    return [
        (size, attackers, other)
        for size, other in product(range(1, n + 1), repeat=2)
        for attackers in range(1, size + 1)
    ]


def attackers_in_groups(n: int) -> list[tuple[int, int, int]]:
    """Sizes of groups smaller than n, active attackers in them, and active attackers among all n (at most n - 1)."""
    return [
        (size, attackers, total_attackers)
        for total_attackers, size in product(range(n), range(1, n))
        for attackers in range(max(size + total_attackers - n, 0), min(size, total_attackers) + 1)
    ]
