"""Which groups to look at: those whose similarities tell most about who lies.

What a frame can tell is the mutual information between the hypothesis (L, b, a) and the similarities of the groups, in
bits. It is computed on an `Outlook`, a weighted list of hypotheses: all of them where they are few, else a sample.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from defenders.bayes.likelihood import BesideTable, Table, entropy
from defenders.bayes.posterior import Posterior

Group = Bool[np.ndarray, " n"]
Groups = Bool[np.ndarray, "X n"]
Others = Bool[np.ndarray, "Y n"]
Rows = Int[np.ndarray, "X M"]
MOST_EXACT = 6  # vehicles up to which every group is tried
ROUNDS = 8  # of local search at most
DIGITS = 9  # of a gain that count: groups that tell as much are equals on any machine


@dataclass(frozen=True, eq=False)
class Outlook:
    """Weighted hypotheses: who is lying now, who was in the references' frame, and how; and whether it is a glitch."""

    now: Float[np.ndarray, "M n"]
    then: Float[np.ndarray, "M n"]
    manner: Int[np.ndarray, "2 M"]  # now, then
    glitch: Bool[np.ndarray, "2 M"]  # now, then
    weight: Float[np.ndarray, " M"]


@dataclass(frozen=True, eq=False)
class Aside:
    """The free view of this frame, of all present, which every view of a smaller group is compared with as well."""

    present: Group
    table: BesideTable


@dataclass(frozen=True, eq=False)
class Reference:
    """An earlier view of a group, and the densities for its age; and what else a view is compared with."""

    group: Group
    table: Table
    aside: Aside | None = None


@dataclass(frozen=True, eq=False)
class Look:
    """A group to look at, the reference to compare it with, and the bits expected of that."""

    group: Group
    reference: Reference
    gain: float


def outlook(posterior: Posterior, rng: np.random.Generator, size: int) -> Outlook:
    """All hypotheses of positive mass, or a systematic sample of `size` where there are more."""
    mass = posterior.mass.reshape(-1)
    chosen, weight = np.flatnonzero(mass > 0), mass[mass > 0]
    if len(chosen) > size:
        steps = np.minimum(np.cumsum(mass), 1.0)
        chosen = np.searchsorted(steps, (np.arange(size) + rng.random()) / size).clip(max=len(mass) - 1)
        chosen, times = np.unique(chosen, return_counts=True)
        weight = times / size
    which, then, now = np.unravel_index(chosen, posterior.joint.shape)
    liars, manner = posterior.sets[which].astype(float), np.stack([now, then])
    lying = manner > 0
    return Outlook(liars * lying[0, :, None], liars * lying[1, :, None], manner, ~liars.any(1) & lying, weight)


def gains(groups: Groups, reference: Reference, of: Outlook) -> Float[np.ndarray, " X"]:
    """Bits expected from each group alone, compared with the reference, and with the free view if that is aside.

    The two similarities are independent given (L, b, a), so what is not known of them once the hypothesis is, is the
    sum of the entropies of two rows of the tables; only their joint mixture over the hypotheses has to be added up.
    """
    table, rows = reference.table, compared(groups, reference, of)
    found, rest = of.weight[:, None] * table.density[rows], table.entropy[rows]
    if reference.aside is None:
        return entropy(found.sum(1)) - rest @ of.weight
    beside, others = reference.aside.table, compared_aside(groups, reference.aside, of)
    pairs = np.matmul(found.swapaxes(1, 2), beside.density[others])
    return entropy(pairs, (1, 2)) - (rest + beside.entropy[others]) @ of.weight


def compared(groups: Groups, reference: Reference, of: Outlook) -> Rows:
    """Which row of the reference's table each group belongs to under each hypothesis."""
    liars = (groups @ of.now.T - of.glitch[0]).astype(np.int64)
    its = (reference.group @ of.then.T - of.glitch[1]).astype(np.int64)
    sizes, shared = groups.sum(1)[:, None], (groups & reference.group).sum(1)[:, None]
    return reference.table.rows(
        sizes, liars, int(reference.group.sum()), its[None], shared, of.manner[:1], of.manner[1:]
    )


def compared_aside(groups: Groups, aside: Aside, of: Outlook) -> Rows:
    """Which row of the free view's table each group belongs to under each hypothesis."""
    liars = (groups @ of.now.T).astype(np.int64)
    lying = (aside.present @ of.now.T - of.glitch[0]).astype(np.int64)
    return aside.table.rows(groups.sum(1)[:, None], liars, lying[None], of.manner[:1])


def best_reference(group: Group, references: list[Reference], of: Outlook) -> Reference:
    """The reference by which a view of the group tells most; the first of equals."""
    return max((pick(group[None], reference, of) for reference in references), key=lambda look: look.gain).reference


def best_look(references: list[Reference], of: Outlook, present: Group, seen: Others, rng: np.random.Generator) -> Look:
    """The group of those present, not `seen` yet, that tells most. Exact up to `MOST_EXACT` vehicles.

    There must be one: two are present at least.
    """
    few = len(present) <= MOST_EXACT
    looks = [(exhaustive(one, of, present, seen) if few else climb(one, of, present, seen, rng)) for one in references]
    return max(looks, key=lambda look: look.gain)


def every_group(present: Group) -> Groups:
    """All groups of one or more of those present."""
    codes = np.arange(1, 2 ** len(present))
    groups = (codes[:, None] >> np.arange(len(present)) & 1).astype(bool)
    return groups[~(groups & ~present).any(1)]


def exhaustive(reference: Reference, of: Outlook, present: Group, seen: Others) -> Look:
    """The best of all groups."""
    return pick(unseen(every_group(present), seen), reference, of)


def climb(reference: Reference, of: Outlook, present: Group, seen: Others, rng: np.random.Generator) -> Look:
    """A good group, found by local search.

    From the best of the heads of a list of vehicles, least suspicious first (and of one in random order, and of one
    reversed), one vehicle at a time is added or removed while that tells more.
    """
    n = of.now.shape[1]
    suspicion = of.weight @ of.now
    orders = [np.lexsort([rng.random(n), suspicion]), rng.permutation(n), np.lexsort([rng.random(n), -suspicion])]
    heads = np.concatenate([np.tril(np.ones((n, n), dtype=bool))[:, np.argsort(order)][:-1] for order in orders])
    best = pick(unseen(heads & present, seen), reference, of)
    for _ in range(ROUNDS):
        other = pick(unseen(best.group ^ np.eye(n, dtype=bool)[present], seen), reference, of)
        if other.gain <= best.gain + 1e-9:
            break
        best = other
    return best


def unseen(groups: Groups, seen: Others) -> Bool[np.ndarray, "Z n"]:
    """Those of the groups that are neither empty nor seen."""
    return groups[groups.any(1) & (groups[:, None] != seen).any(2).all(1)]


def pick(groups: Groups, reference: Reference, of: Outlook) -> Look:
    """The best of the groups."""
    found = gains(groups, reference, of).round(DIGITS)
    best = int(found.argmax())
    return Look(groups[best], reference, float(found[best]))


def safest(
    posterior: Posterior,
    worth: Float[np.ndarray, "A sizes counts"],
    barred: Group,
    present: Group,
    rng: np.random.Generator,
) -> Group:
    """The group of those present of highest expected worth in this frame, without those barred (unless that is all).

    `worth[manner, size, liars]` is a view's; its last column stands for a glitch. Up to `MOST_EXACT` vehicles every
    group is tried, else the heads of the list of vehicles, least suspicious first.
    """
    mass = posterior.mass.sum(1)  # [S, a]
    n = len(barred)
    nobody = posterior.sets.sum(1) == 0
    groups: Groups
    if n <= MOST_EXACT:
        groups = every_group(present)
    else:
        order = np.lexsort([rng.random(n), mass[:, 1:].sum(1) @ posterior.sets, barred])
        groups = np.tril(np.ones((n, n), dtype=bool))[:, np.argsort(order)] & present
        groups = groups[groups.any(1)]
    if not barred[present].all():
        groups = groups[~(groups & barred).any(1)]
    sizes = groups.sum(1)
    liars = posterior.sets.astype(float) @ groups.T.astype(float)
    columns = np.where(nobody[:, None], -1, liars.astype(np.int64))
    value = mass[:, 0].sum() * worth[0, sizes, 0]
    for manner in range(1, mass.shape[1]):
        active = mass[:, manner] > 1e-9
        value = value + mass[active, manner] @ worth[manner, sizes[None], columns[active]]
    return groups[int(value.argmax())]
