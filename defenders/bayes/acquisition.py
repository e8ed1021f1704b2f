"""Choice of the next verification: the group whose similarities are expected to be most informative.

The expected information is the mutual information, in bits, between the hypothesis (L, b, a) and the similarities of
the group. It is computed on a `HypothesisSample`, a weighted list of hypotheses: all of them where they are few, else
a sample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from defenders.bayes.likelihood import FullViewTable, Table, entropy
from defenders.bayes.posterior import Posterior

Group = Bool[np.ndarray, " n"]
Groups = Bool[np.ndarray, "X n"]
Others = Bool[np.ndarray, "Y n"]
Rows = Int[np.ndarray, "X M"]
MOST_EXACT = 6  # vehicles up to which every group is tried
ROUNDS = 8  # of local search, at most
DIGITS = 9  # of a gain that count, so that ties are ties on every machine


@dataclass(frozen=True, eq=False)
class HypothesisSample:
    """Weighted hypotheses: who attacks now, who attacked in the references' frame, in which mode, and outliers."""

    now: Float[np.ndarray, "M n"]
    then: Float[np.ndarray, "M n"]
    mode: Int[np.ndarray, "2 M"]  # now, then
    outlier: Bool[np.ndarray, "2 M"]  # now, then
    weight: Float[np.ndarray, " M"]


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


@dataclass(frozen=True, eq=False)
class Candidate:
    """A group to verify, the reference to compare it with, and the expected information in bits."""

    group: Group
    reference: Reference
    gain: float


def sample_hypotheses(posterior: Posterior, rng: np.random.Generator, size: int) -> HypothesisSample:
    """All hypotheses of positive mass, or a systematic sample of `size` where there are more."""
    mass = posterior.mass.reshape(-1)
    chosen, weight = np.flatnonzero(mass > 0), mass[mass > 0]
    if len(chosen) > size:
        steps = np.minimum(np.cumsum(mass), 1.0)
        chosen = np.searchsorted(steps, (np.arange(size) + rng.random()) / size).clip(max=len(mass) - 1)
        chosen, times = np.unique(chosen, return_counts=True)
        weight = times / size
    which, then, now = np.unravel_index(chosen, posterior.joint.shape)
    attackers, mode = posterior.sets[which].astype(float), np.stack([now, then])
    attacking = mode > 0
    return HypothesisSample(
        attackers * attacking[0, :, None],
        attackers * attacking[1, :, None],
        mode,
        ~attackers.any(1) & attacking,
        weight,
    )


def information_gain(groups: Groups, reference: Reference, hypotheses: HypothesisSample) -> Float[np.ndarray, " X"]:
    """Expected information of each group, in bits, from its similarity to the reference and to the full view.

    The two similarities are independent given (L, b, a). So their conditional entropy is the sum of the entropies of
    two rows of the tables, and only the joint mixture over the hypotheses has to be added up.
    """
    table, rows = reference.table, reference_rows(groups, reference, hypotheses)
    found, rest = hypotheses.weight[:, None] * table.density[rows], table.entropy[rows]
    if reference.full_view is None:
        return entropy(found.sum(1)) - rest @ hypotheses.weight
    full_table, others = reference.full_view.table, full_view_rows(groups, reference.full_view, hypotheses)
    pairs = np.matmul(found.swapaxes(1, 2), full_table.density[others])
    return entropy(pairs, (1, 2)) - (rest + full_table.entropy[others]) @ hypotheses.weight


def reference_rows(groups: Groups, reference: Reference, hypotheses: HypothesisSample) -> Rows:
    """Rows of the reference's table: one for each group and hypothesis."""
    attackers = (groups @ hypotheses.now.T - hypotheses.outlier[0]).astype(np.int64)
    earlier = (reference.group @ hypotheses.then.T - hypotheses.outlier[1]).astype(np.int64)
    sizes, shared = groups.sum(1)[:, None], (groups & reference.group).sum(1)[:, None]
    return reference.table.rows(
        sizes, attackers, int(reference.group.sum()), earlier[None], shared, hypotheses.mode[:1], hypotheses.mode[1:]
    )


def full_view_rows(groups: Groups, full_view: FullView, hypotheses: HypothesisSample) -> Rows:
    """Rows of the full view's table: one for each group and hypothesis."""
    attackers = (groups @ hypotheses.now.T).astype(np.int64)
    total = (full_view.present @ hypotheses.now.T - hypotheses.outlier[0]).astype(np.int64)
    return full_view.table.rows(groups.sum(1)[:, None], attackers, total[None], hypotheses.mode[:1])


def best_reference(group: Group, references: list[Reference], hypotheses: HypothesisSample) -> Reference:
    """The most informative reference for a view of the group; the first of equals."""
    return max(
        (argmax_gain(group[None], reference, hypotheses) for reference in references),
        key=lambda candidate: candidate.gain,
    ).reference


def best_query(
    references: list[Reference], hypotheses: HypothesisSample, present: Group, seen: Others, rng: np.random.Generator
) -> Candidate:
    """The most informative group of the present vehicles that was not seen yet.

    The search is exact up to `MOST_EXACT` vehicles. At least two vehicles must be present.
    """
    few = len(present) <= MOST_EXACT
    found = [
        (exhaustive(one, hypotheses, present, seen) if few else local_search(one, hypotheses, present, seen, rng))
        for one in references
    ]
    return max(found, key=lambda candidate: candidate.gain)


def every_group(present: Group) -> Groups:
    """All groups of one or more of those present."""
    codes = np.arange(1, 2 ** len(present))
    groups = (codes[:, None] >> np.arange(len(present)) & 1).astype(bool)
    return groups[~(groups & ~present).any(1)]


def exhaustive(reference: Reference, hypotheses: HypothesisSample, present: Group, seen: Others) -> Candidate:
    """The best of all groups."""
    return argmax_gain(unseen(every_group(present), seen), reference, hypotheses)


def local_search(
    reference: Reference, hypotheses: HypothesisSample, present: Group, seen: Others, rng: np.random.Generator
) -> Candidate:
    """A good group, found by local search.

    The search starts from the best head of three lists of the vehicles: least suspicious first, in random order, and
    most suspicious first. One vehicle at a time is added or removed while that increases the gain.
    """
    n = hypotheses.now.shape[1]
    suspicion = hypotheses.weight @ hypotheses.now
    orders = [np.lexsort([rng.random(n), suspicion]), rng.permutation(n), np.lexsort([rng.random(n), -suspicion])]
    heads = np.concatenate([np.tril(np.ones((n, n), dtype=bool))[:, np.argsort(order)][:-1] for order in orders])
    best = argmax_gain(unseen(heads & present, seen), reference, hypotheses)
    for _ in range(ROUNDS):
        other = argmax_gain(unseen(best.group ^ np.eye(n, dtype=bool)[present], seen), reference, hypotheses)
        if other.gain <= best.gain + 1e-9:
            break
        best = other
    return best


def unseen(groups: Groups, seen: Others) -> Bool[np.ndarray, "Z n"]:
    """The groups that are neither empty nor seen."""
    return groups[groups.any(1) & (groups[:, None] != seen).any(2).all(1)]


def argmax_gain(groups: Groups, reference: Reference, hypotheses: HypothesisSample) -> Candidate:
    """The group of the highest gain."""
    found = information_gain(groups, reference, hypotheses).round(DIGITS)
    best = int(found.argmax())
    return Candidate(groups[best], reference, float(found[best]))


def best_collaborators(
    posterior: Posterior,
    utility: Float[np.ndarray, "A sizes counts"],
    excluded: Group,
    present: Group,
    rng: np.random.Generator,
) -> Group:
    """The group of the present vehicles with the highest expected utility in this frame.

    Args:
        posterior: Probabilities of the hypotheses.
        utility: `utility[mode, size, attackers]` of a view; the last column stands for an outlier.
        excluded: Vehicles that are left out, unless that leaves nobody.
        present: Vehicles that are present.
        rng: Breaks ties.

    Returns:
        The members. Up to `MOST_EXACT` vehicles every group is tried; above, the heads of the list of vehicles, least
        suspicious first.
    """
    mass = posterior.mass.sum(1)  # [S, a]
    n = len(excluded)
    nobody = posterior.sets.sum(1) == 0
    groups: Groups
    if n <= MOST_EXACT:
        groups = every_group(present)
    else:
        order = np.lexsort([rng.random(n), mass[:, 1:].sum(1) @ posterior.sets, excluded])
        groups = np.tril(np.ones((n, n), dtype=bool))[:, np.argsort(order)] & present
        groups = groups[groups.any(1)]
    if not excluded[present].all():
        groups = groups[~(groups & excluded).any(1)]
    sizes = groups.sum(1)
    attackers = posterior.sets.astype(float) @ groups.T.astype(float)
    columns = np.where(nobody[:, None], -1, attackers.astype(np.int64))
    value = mass[:, 0].sum() * utility[0, sizes, 0]
    for mode in range(1, mass.shape[1]):
        active = mass[:, mode] > 1e-9
        value = value + mass[active, mode] @ utility[mode, sizes[None], columns[active]]
    return groups[int(value.argmax())]
