"""What is known before any episode: all that follows from the densities and the number of vehicles alone."""

from __future__ import annotations

from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from defenders.bayes.histograms import Calibrated
from defenders.bayes.information import FullView, Reference
from defenders.bayes.likelihood import FullViewTable, Likelihood, Verifier, read_only
from defenders.bayes.small_fleet import MOST_EXACT, list_outcomes

FLEETS = 8
"""Fleets that are kept for defenders to come, and numbers of present vehicles that are kept for each."""
REFERENCES = 256
"""References and groups that are kept for each fleet: up to six vehicles nearly all there are."""


class Fleet:
    """Tables for every episode of a fleet of `n`: nothing of an episode is in them, and they are read-only.

    What is not known at once is worked out when it is first asked for, and the last that were asked for are kept. A
    copy of a defender shares them with it. A pickle holds the densities only.
    """

    def __init__(self, likelihood: Likelihood, n: int, listed: bool) -> None:
        """Build the tables.

        Args:
            likelihood: The densities.
            n: Vehicles.
            listed: Whether the posterior is a list of all sets of attackers: no particles.
        """
        self.likelihood, self.n, self.listed = likelihood, n, listed
        self.tables, self.utility = likelihood.tables(n), utility_table(likelihood, n)
        self.members = lru_cache(REFERENCES)(self._members)
        self.discrimination = lru_cache(REFERENCES)(likelihood.discrimination)
        self._full_view_table = lru_cache(FLEETS)(self._make_full_view_table)
        self._reference = lru_cache(REFERENCES)(self._make_reference)

    def reference(self, group: frozenset[int], age: int, present: frozenset[int] | None = None) -> Reference:
        """A group's view as a reference.

        Args:
            group: Its members.
            age: Frames since it was perceived.
            present: Vehicles of the full view that views are compared with, too; None if they are not.
        """
        return self._reference(group, min(age, len(self.tables)), present)

    def _members(self, group: frozenset[int]) -> Bool[np.ndarray, " n"]:
        members = np.zeros(self.n, dtype=bool)
        members[list(group)] = True
        return read_only(members)

    def _make_full_view_table(self, present: int) -> FullViewTable:
        return FullViewTable(self.likelihood, present)

    def _make_reference(self, group: frozenset[int], age: int, present: frozenset[int] | None) -> Reference:
        full_view = None
        if present is not None:
            full_view = FullView(self.members(present), self._full_view_table(len(present)))
        reference = Reference(self.members(group), self.tables[age - 1], full_view)
        return list_outcomes(reference) if self.listed and self.n <= MOST_EXACT else reference

    def __deepcopy__(self, memo: dict[int, Any]) -> Fleet:
        return self

    def __reduce__(self) -> Any:
        return open_fleet, (self.likelihood, self.n, self.listed)


def open_fleet(likelihood: Likelihood, n: int, listed: bool) -> Fleet:
    """The tables of a fleet, see `Fleet`. Defenders of equal densities share them, if the densities are our own."""
    ours = type(likelihood) in (Calibrated, Verifier)  # read-only, and known by their values
    return _kept_fleet(likelihood, n, listed) if ours else Fleet(likelihood, n, listed)


@lru_cache(FLEETS)
def _kept_fleet(likelihood: Likelihood, n: int, listed: bool) -> Fleet:
    return Fleet(likelihood, n, listed)


def utility_table(likelihood: Likelihood, n: int) -> Float[np.ndarray, "A sizes counts"]:
    """`utility[mode, size, attackers]` of a view. The last column, -1, is an outlier: all groups are equal."""
    table = np.zeros((likelihood.modes + 1, n + 1, n + 2))
    for mode, size in product(range(likelihood.modes + 1), range(1, n + 1)):
        utility = [likelihood.utility(size, attackers, mode) for attackers in range(size + 1 if mode else 1)]
        table[mode, size, : len(utility)] = utility
    table[:, 1:, -1] = likelihood.utility(1, 0)
    return read_only(table)
