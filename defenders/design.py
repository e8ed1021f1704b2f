"""Which groups to look at: those whose similarities tell most about who lies.

What a frame can tell is the mutual information between the hypothesis (L, b, a) and the similarities of the groups, in
bits. It is computed on an `Outlook`, a weighted list of hypotheses: all of them where they are few, else a sample.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from defenders.likelihood import Table
from defenders.posterior import Posterior

Group = Bool[np.ndarray, " n"]
Groups = Bool[np.ndarray, "X n"]
Outcomes = Float[np.ndarray, "X M B"]
Others = Float[np.ndarray, "Y M B"]
MOST_EXACT = 5  # vehicles up to which every pair of groups is tried
ROUNDS = 8  # of local search at most


@dataclass(frozen=True, eq=False)
class Outlook:
    """Weighted hypotheses: who is lying now, who was in the references' frame, and whether that was a glitch."""

    now: Float[np.ndarray, "M n"]
    then: Float[np.ndarray, "M n"]
    glitch: Float[np.ndarray, "2 M"]  # now, then
    weight: Float[np.ndarray, " M"]


@dataclass(frozen=True, eq=False)
class Reference:
    """An earlier view of a group, and the densities for its age."""

    group: Group
    table: Table


@dataclass(frozen=True, eq=False)
class Plan:
    """Groups to look at, the reference to compare each with, and the bits expected of all together."""

    groups: tuple[Group, ...]
    references: tuple[Reference, ...]
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
    liars = posterior.sets[chosen // 4].astype(float)
    then, now = chosen // 2 % 2, chosen % 2
    nobody = ~liars.any(1)
    return Outlook(
        liars * now[:, None], liars * then[:, None], np.stack([nobody & (now == 1), nobody & (then == 1)]) * 1.0, weight
    )


def outcomes(groups: Groups, reference: Reference, of: Outlook) -> Outcomes:
    """Probability of each bin, for each group compared with the reference under each hypothesis."""
    liars = (groups @ of.now.T - of.glitch[0]).astype(np.int64)
    its = (reference.group @ of.then.T - of.glitch[1]).astype(np.int64)
    sizes, shared = groups.sum(1)[:, None], (groups & reference.group).sum(1)[:, None]
    rows = reference.table.rows(sizes, liars, int(reference.group.sum()), its[None], shared)
    return reference.table.density[rows]


def entropy(p: np.ndarray, axis: int | tuple[int, ...] = -1) -> np.ndarray:
    """In bits; 0 log 0 is 0."""
    return -(p * np.log2(np.maximum(p, 1e-300))).sum(axis)


def gain_of_one(found: Outcomes, weight: Float[np.ndarray, " M"]) -> Float[np.ndarray, " X"]:
    """Bits expected from each group alone."""
    return entropy(weight @ found) - entropy(found) @ weight


def gain_of_two(one: Others, two: Outcomes, weight: Float[np.ndarray, " M"]) -> Float[np.ndarray, "Y X"]:
    """Bits expected from every pair of a group of `one` and a group of `two`; they are independent given (L, b, a)."""
    (x, m, b), y = one.shape, len(two)
    left = (one * weight[:, None]).transpose(0, 2, 1).reshape(x * b, m)
    both = (left @ two.transpose(1, 0, 2).reshape(m, y * b)).reshape(x, b, y, b)
    alone = entropy(one) @ weight, entropy(two) @ weight
    return entropy(both, axis=(1, 3)) - alone[0][:, None] - alone[1]


def best_reference(group: Group, references: list[Reference], of: Outlook) -> tuple[Reference, float]:
    """The reference by which a view of the group tells most; the first of equals."""
    gains = [float(gain_of_one(outcomes(group[None], reference, of), of.weight)[0]) for reference in references]
    best = int(np.argmax(gains))
    return references[best], gains[best]


def plan(references: list[Reference], of: Outlook, rng: np.random.Generator) -> Plan:
    """The two groups that tell most; one of them may add nothing. Exact up to `MOST_EXACT` vehicles."""
    return exhaustive(references, of) if of.now.shape[1] <= MOST_EXACT else local(references, of, rng)


def every_group(n: int) -> Groups:
    """All non-empty groups of fewer than all vehicles; the one vehicle there is where there is one."""
    codes = np.arange(1, max(2**n - 1, 2))
    return (codes[:, None] >> np.arange(n) & 1).astype(bool)


def exhaustive(references: list[Reference], of: Outlook) -> Plan:
    """Every pair of groups, each compared with the reference by which it tells most alone."""
    groups = every_group(of.now.shape[1])
    by_reference = np.stack([outcomes(groups, reference, of) for reference in references])
    alone = np.stack([gain_of_one(found, of.weight) for found in by_reference])
    whose = alone.argmax(0)
    found = by_reference[whose, np.arange(len(groups))]
    gains = gain_of_two(found, found, of.weight)
    np.fill_diagonal(gains, alone.max(0))  # a group looked at twice is looked at once
    one, two = np.unravel_index(int(gains.argmax()), gains.shape)
    chosen = [one] if one == two else [one, two]
    return Plan(tuple(groups[i] for i in chosen), tuple(references[whose[i]] for i in chosen), float(gains[one, two]))


def local(references: list[Reference], of: Outlook, rng: np.random.Generator) -> Plan:
    """The best first group by local search, then the best beside it, then the first again beside the second."""
    ones = [climb(reference, of, None, rng) for reference in references]
    best = int(np.argmax([gain for _, gain in ones]))
    reference, one = references[best], ones[best][0]
    two, _ = climb(reference, of, outcomes(one[None], reference, of), rng)
    one, gain = climb(reference, of, outcomes(two[None], reference, of), rng, one)
    return Plan((one, two), (reference, reference), gain)


def climb(
    reference: Reference, of: Outlook, beside: Others | None, rng: np.random.Generator, start: Group | None = None
) -> tuple[Group, float]:
    """A group that tells most, beside another's outcomes if given, and the bits of both.

    From the best of the heads of a list of vehicles, least suspicious first (and of one in random order, so that a
    second group can differ), one vehicle at a time is added or removed while that tells more.
    """
    n = of.now.shape[1]
    suspicion = of.weight @ of.now
    orders = [np.lexsort([rng.random(n), suspicion]), rng.permutation(n), np.lexsort([rng.random(n), -suspicion])]
    heads = np.concatenate([np.tril(np.ones((n, n), dtype=bool))[:, np.argsort(order)][:-1] for order in orders])
    best, gain = pick(heads if start is None else start[None], reference, of, beside)
    for _ in range(ROUNDS):
        flipped = best ^ np.eye(n, dtype=bool)
        flipped = flipped[flipped.any(1) & ~flipped.all(1)]
        other, more = pick(flipped, reference, of, beside)
        if more <= gain + 1e-9:
            break
        best, gain = other, more
    return best, gain


def pick(groups: Groups, reference: Reference, of: Outlook, beside: Others | None) -> tuple[Group, float]:
    """The best of the groups, and its gain."""
    found = outcomes(groups, reference, of)
    gains = gain_of_one(found, of.weight) if beside is None else gain_of_two(beside, found, of.weight)[0]
    best = int(gains.argmax())
    return groups[best], float(gains[best])


def safest(
    posterior: Posterior, worth: Float[np.ndarray, "sizes counts"], barred: Group, rng: np.random.Generator
) -> Group:
    """The group of highest expected worth in this frame, without those barred (unless that is everyone).

    `worth[size, liars]` is a view's; its last column stands for a glitch. Up to `MOST_EXACT` vehicles every group is
    tried, else the heads of the list of vehicles, least suspicious first.
    """
    mass = posterior.mass.sum(1)  # [S, a]
    n = len(barred)
    nobody = posterior.sets.sum(1) == 0
    groups: Groups
    if n <= MOST_EXACT:
        groups = np.concatenate([every_group(n), np.ones((1, n), dtype=bool)])
    else:
        order = np.lexsort([rng.random(n), mass[:, 1] @ posterior.sets, barred])
        groups = np.tril(np.ones((n, n), dtype=bool))[:, np.argsort(order)]
    if not barred.all():
        groups = groups[~(groups & barred).any(1)]
    sizes = groups.sum(1)
    active = mass[:, 1] > 1e-9
    liars = posterior.sets[active].astype(float) @ groups.T.astype(float)
    columns = np.where(nobody[active, None], -1, liars.astype(np.int64))
    value = mass[active, 1] @ worth[sizes[None], columns] + (1 - mass[active, 1].sum()) * worth[sizes, 0]
    return groups[int(value.argmax())]
