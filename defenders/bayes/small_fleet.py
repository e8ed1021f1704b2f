"""References of a small fleet, for which every group and every hypothesis is listed once and for all."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Int, UInt

from defenders.bayes.information import Gains, Group, Groups, HypothesisSample, Reference
from defenders.bayes.likelihood import entropy, read_only
from defenders.bayes.posterior import Known, every_set

MOST_EXACT = 6  # vehicles up to which every group is tried
BITS = 1 << np.arange(MOST_EXACT)


@dataclass(frozen=True, eq=False, kw_only=True)
class ListedReference(Reference):
    """A reference that knows which densities each group's similarities have under each hypothesis.

    Many hypotheses give the groups of one size the same pair of densities: they are of one *kind*. So the mass of all
    hypotheses of a kind is added up first, and only then are densities mixed. The sums are those of `Reference` in
    another order. What is listed depends on no episode and is never written to.

    The masses are held in one array [size, rank, kind], where `rank` counts the groups of a size. `place` is the place
    in it, flattened, to which a hypothesis adds its mass. Groups are numbered by their members as bits.
    """

    place: UInt[np.ndarray, "codes H"]  # of every group and hypothesis
    row: Int[np.ndarray, "sizes kinds"]  # of the reference's table
    other: Int[np.ndarray, "sizes kinds"]  # of the full view's table
    ranks: int

    def information_gain(self, groups: Groups, hypotheses: HypothesisSample) -> Gains:
        """As `Reference.information_gain`; `hypotheses` must be of `every_set`."""
        mass, (sizes, kinds), listed = hypotheses.mass.reshape(-1), self.row.shape, self.place[codes(groups)]
        chosen = np.flatnonzero(mass)
        place = listed.take(chosen, axis=1)
        weight = np.empty(place.shape)
        weight[:] = mass[chosen]
        of_kind = np.bincount(place.reshape(-1), weight.reshape(-1), sizes * self.ranks * kinds)
        of_kind = of_kind.reshape(sizes, self.ranks, kinds)
        density, rest = self.table.density[self.row], self.table.entropy[self.row]
        if self.full_view is not None:
            others = self.full_view.table.density[self.other]
            density = (density[:, :, :, None] * others[:, :, None]).reshape(sizes, kinds, -1)
            rest = rest + self.full_view.table.entropy[self.other]
        gains = entropy(of_kind @ density) - (of_kind * rest[:, None]).sum(2)
        return gains.reshape(-1)[listed[:, 0] // kinds]

    def evidence(self, group: Group, found: int) -> Known:
        """As `Reference.evidence`, looked up."""
        return self._known(group, self.table.density[self.row[group.sum() - 1], found])

    def full_view_evidence(self, group: Group, found: int) -> Known:
        """As `Reference.full_view_evidence`, looked up."""
        assert self.full_view is not None
        return self._known(group, self.full_view.table.density[self.other[group.sum() - 1], found])

    def _known(self, group: Group, of_kind: np.ndarray) -> Known:
        modes = self.table.modes + 1
        return Known(of_kind[self.place[codes(group)] % len(of_kind)].reshape(-1, modes, modes))


def list_outcomes(reference: Reference) -> ListedReference:
    """List the kinds of hypotheses for every group that may be compared with a reference of a small fleet."""
    full_view, n, modes = reference.full_view, len(reference.group), reference.table.modes + 1
    sets = every_set(n)
    hypotheses = HypothesisSample(sets, np.ones((len(sets), modes, modes)))
    groups = every_group(np.ones(n, dtype=bool) if full_view is None else full_view.present)
    if full_view is not None and len(groups) > 1:
        groups = groups[:-1]  # the last is that of the full view itself
    pairs, count = reference.rows(groups, hypotheses), 1
    if full_view is not None:
        count = len(full_view.table.density)
        pairs = pairs * count + reference.full_view_rows(groups, hypotheses)
    of_size = [groups.sum(1) == size for size in range(1, groups.sum(1).max() + 1)]
    listed = [np.unique(pairs[chosen], return_inverse=True) for chosen in of_size]
    ranks, kinds = max(chosen.sum() for chosen in of_size), max(len(found) for found, _ in listed)
    pair, place = np.zeros((len(of_size), kinds), dtype=np.int64), np.zeros((2**n, len(hypotheses.weight)), np.int64)
    for size, (chosen, (found, kind)) in enumerate(zip(of_size, listed, strict=True)):
        pair[size, : len(found)] = found
        slot = size * ranks + np.arange(chosen.sum())
        place[codes(groups[chosen])] = slot[:, None] * kinds + kind.reshape(len(slot), -1)
    place = place.astype(np.min_scalar_type(place.max()))  # a quarter of the memory, or an eighth
    (row, other), ranks = np.divmod(pair, count), int(ranks)
    for array in (place, row, other):
        read_only(array)
    return ListedReference(reference.group, reference.table, full_view, place=place, row=row, other=other, ranks=ranks)


def every_group(present: Group) -> Groups:
    """All groups of one or more of those present."""
    groups = _every_group(len(present))
    return groups if present.all() else groups[~(groups & ~present).any(1)]


@lru_cache(maxsize=MOST_EXACT)
def _every_group(n: int) -> Groups:
    groups = (np.arange(1, 2**n)[:, None] >> np.arange(n) & 1).astype(bool)
    return read_only(groups)


def codes(groups: Bool[np.ndarray, "*any n"]) -> Int[np.ndarray, "*any"] | np.int64:
    """Numbers of groups: their members as bits."""
    return groups @ BITS[: groups.shape[-1]]
