"""Choice of the next verification, the group with the highest expected information, and of the collaborators."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from defenders.bayes.information import Group, Groups, HypothesisSample, Reference
from defenders.bayes.posterior import Posterior
from defenders.bayes.small_fleet import MOST_EXACT, every_group

Others = Bool[np.ndarray, "Y n"]
ROUNDS = 8  # of local search, at most
DIGITS = 9  # of a gain that count, so that ties are ties on every machine


@dataclass(frozen=True, eq=False)
class Candidate:
    """A group to verify, the reference to compare it with, and the expected information in bits."""

    group: Group
    reference: Reference
    gain: float


def best_reference(group: Group, references: list[Reference], hypotheses: HypothesisSample) -> Reference:
    """The most informative reference for a view of the group; the first of equals."""
    if len(references) == 1:
        return references[0]
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
    found = reference.information_gain(groups, hypotheses).round(DIGITS)
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
