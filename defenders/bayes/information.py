"""Expected information of a verification: how much the similarities of a group's view say about the attackers.

It is the mutual information, in bits, between the hypothesis (L, b, a) and the similarities of the group's view to a
reference and to the full view. It is computed on a `HypothesisSample`. `defenders.bayes.small_fleet` computes it faster
where all groups and hypotheses can be listed.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from defenders.bayes.likelihood import FullViewTable, Table, entropy
from defenders.bayes.posterior import Comparison, Evidence, FullViewComparison, Joint, Posterior, Sets

Group = Bool[np.ndarray, " n"]
Groups = Bool[np.ndarray, "X n"]
Gains = Float[np.ndarray, " X"]
Rows = Int[np.ndarray, "X M"]


@dataclass(frozen=True, eq=False)
class HypothesisSample:
    """The M hypotheses (L, b, a) of positive mass: all there are, or a sample."""

    sets: Sets
    mass: Joint  # 0 for hypotheses that were not drawn

    @cached_property
    def weight(self) -> Float[np.ndarray, " M"]:
        """Mass of each."""
        return self.mass[self._where]

    @cached_property
    def mode(self) -> Int[np.ndarray, "2 M"]:
        """Mode of the attack: now, and in the references' frame."""
        return np.stack([self._where[2], self._where[1]])

    @cached_property
    def now(self) -> Float[np.ndarray, "M n"]:
        """Who attacks now."""
        return self._attackers * (self.mode[0] > 0)[:, None]

    @cached_property
    def then(self) -> Float[np.ndarray, "M n"]:
        """Who attacked in the references' frame."""
        return self._attackers * (self.mode[1] > 0)[:, None]

    @cached_property
    def outlier(self) -> Bool[np.ndarray, "2 M"]:
        """Whether it is an outlier: now, and in the references' frame."""
        return ~self._attackers.any(1) & (self.mode > 0)

    @cached_property
    def _where(self) -> tuple[np.ndarray, ...]:
        return np.nonzero(self.mass)

    @cached_property
    def _attackers(self) -> Float[np.ndarray, "M n"]:
        return self.sets[self._where[0]].astype(float)


def sample_hypotheses(posterior: Posterior, rng: np.random.Generator, size: int) -> HypothesisSample:
    """All hypotheses of positive mass, or a systematic sample of `size` where there are more."""
    mass = posterior.mass
    if mass.size > size and np.count_nonzero(mass) > size:
        steps = np.minimum(np.cumsum(mass), 1.0)
        chosen = np.searchsorted(steps, (np.arange(size) + rng.random()) / size).clip(max=mass.size - 1)
        times = np.bincount(chosen, minlength=mass.size)
        mass = (times / size).reshape(mass.shape)
    return HypothesisSample(posterior.sets, mass)


@dataclass(frozen=True, eq=False)
class FullView:
    """The full view of this frame, of all present. Every view of a smaller group is compared with it, too."""

    present: Group
    table: FullViewTable


@dataclass(frozen=True, eq=False)
class Reference:
    """An earlier view of a group, the densities for its age, and the full view if views are compared with that, too."""

    group: Group
    table: Table
    full_view: FullView | None = None

    def information_gain(self, groups: Groups, hypotheses: HypothesisSample) -> Gains:
        """Expected information of each group, in bits, from its similarity to the reference and to the full view.

        The two similarities are independent given (L, b, a). So their conditional entropy is the sum of the entropies
        of two rows of the tables, and only the joint mixture over the hypotheses has to be added up.
        """
        table, rows = self.table, self.rows(groups, hypotheses)
        found, rest = hypotheses.weight[:, None] * table.density[rows], table.entropy[rows]
        if self.full_view is None:
            return entropy(found.sum(1)) - rest @ hypotheses.weight
        full_table, others = self.full_view.table, self.full_view_rows(groups, hypotheses)
        pairs = np.matmul(found.swapaxes(1, 2), full_table.density[others])
        return entropy(pairs, (1, 2)) - (rest + full_table.entropy[others]) @ hypotheses.weight

    def evidence(self, group: Group, found: int) -> Evidence:
        """The group's binned similarity to the reference."""
        return Comparison(group, self.group, self.table, found)

    def full_view_evidence(self, group: Group, found: int) -> Evidence:
        """The group's binned similarity to the full view."""
        assert self.full_view is not None
        return FullViewComparison(group, self.full_view.present, self.full_view.table, found)

    def rows(self, groups: Groups, hypotheses: HypothesisSample) -> Rows:
        """Rows of the table: one for each group and hypothesis."""
        attackers = (groups @ hypotheses.now.T - hypotheses.outlier[0]).astype(np.int64)
        earlier = (self.group @ hypotheses.then.T - hypotheses.outlier[1]).astype(np.int64)
        sizes, shared, (now, then) = groups.sum(1), (groups & self.group).sum(1), hypotheses.mode
        rows = np.empty(attackers.shape, dtype=np.int64)
        for size, both in set(zip(sizes.tolist(), shared.tolist(), strict=True)):
            same = (sizes == size) & (shared == both)
            rows[same] = self.table.rows(size, int(self.group.sum()), both)[now, attackers[same], then, earlier]
        return rows

    def full_view_rows(self, groups: Groups, hypotheses: HypothesisSample) -> Rows:
        """Rows of the full view's table: one for each group and hypothesis."""
        assert self.full_view is not None
        attackers = (groups @ hypotheses.now.T).astype(np.int64)
        total = (self.full_view.present @ hypotheses.now.T - hypotheses.outlier[0]).astype(np.int64)
        return self.full_view.table.rows(groups.sum(1)[:, None], attackers, total, hypotheses.mode[0])
