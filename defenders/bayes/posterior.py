"""A posterior over sets of attackers, and over whether they were active when the reference was perceived.

A hypothesis is a set L of attackers. The number of attackers is uniform on 0 … n - 1, and the set is uniform given its
number. In each frame the attackers are either active, all of them and in one mode (a = 1, 2, …), with probability q_a,
or they pause (a = 0). The index b says the same of the frame that the reference comes from.

Attacks are likelier after attacks of their mode: q_a lies between its equal share of ONSET_PROB and its own
PERSISTENCE_PROB, by the probability that the frame before held such an attack.

If there is no attacker, a > 0 is an *outlier*: an attack seems to show, whoever is in a view. Against the full view of
the same frame it seldom does (`likelihood.OUTLIER_MIX`). Outliers have the weight g_a, and no share of it is given back
to a = 0. So a frame in which nothing shows says nothing about L, and attackers that pause are not acquitted.

In a frame with an attack, L is drawn anew with probability φ. So a vehicle may start to attack at any time, and no
verdict is final. Attackers that have just started were benign in the reference.

    p(L, b, a = 0) ∝ (1 - Σ q_a) p(L, b)
    p(L, b, a > 0) ∝ q_a ((1 - φ) p(L, b) + φ p₀(L) [b = 0]) (g_a if L = ∅ else 1)

The recursion is pointwise in L: of the other sets it needs only the normaliser.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import comb

import numpy as np
from jaxtyping import Bool, Float

from defenders.bayes.likelihood import FullViewTable, Table, read_only

OUTLIER_PRIOR = np.array([0.05, 4.0])  # g_a, by mode: streets in which benign views agree little are not rare
ONSET_PROB = 0.02  # Σ q after a pause
PERSISTENCE_PROB = np.array([0.7, 0.85])  # q of a mode after a frame with such an attack; to end a stealthy one shows

LISTS = 4  # fleets whose list of all sets is kept

Sets = Bool[np.ndarray, "S n"]
Density = Float[np.ndarray, "S A"]
Joint = Float[np.ndarray, "S A A"]  # A modes, among them 0: no attack
ModeProbs = Float[np.ndarray, " modes"]  # of every mode of attack


@dataclass(frozen=True, eq=False)
class Comparison:
    """A binned similarity of a group's view to a reference."""

    group: Bool[np.ndarray, " n"]
    reference: Bool[np.ndarray, " n"]
    table: Table  # of the reference's age
    bin: int

    def likelihood(self, sets: Sets) -> Joint:
        """Probability of the similarity under every (L, b, a)."""
        rows = self.table.rows(
            int(self.group.sum()), int(self.reference.sum()), int((self.group & self.reference).sum())
        )
        nobody, modes = ~sets.any(1), np.arange(self.table.modes + 1)
        now = np.where(nobody, -1, sets[:, self.group].sum(1))[:, None, None]
        then = np.where(nobody, -1, sets[:, self.reference].sum(1))[:, None, None]
        return self.table.density[rows[modes, now, modes[:, None], then], self.bin]


@dataclass(frozen=True, eq=False)
class FullViewComparison:
    """A binned similarity of a group's view to the full view of the same frame, of all present."""

    group: Bool[np.ndarray, " n"]
    present: Bool[np.ndarray, " n"]
    table: FullViewTable  # of so many present
    bin: int

    def likelihood(self, sets: Sets) -> Joint:
        """Probability of the similarity under every (L, b, a); b says nothing about it."""
        total = np.where(sets.any(1), sets[:, self.present].sum(1), -1)
        attackers, modes = sets[:, self.group].sum(1), np.arange(self.table.modes + 1)
        rows = self.table.rows(int(self.group.sum()), attackers[:, None], total[:, None], modes)
        values = self.table.density[rows, self.bin]
        return np.broadcast_to(values[:, None], (len(sets), len(modes), len(modes)))


@dataclass(frozen=True, eq=False)
class Known:
    """A binned similarity whose probability under every (L, b, a) was looked up."""

    values: Joint

    def likelihood(self, sets: Sets) -> Joint:
        """The values, which are those of all listed sets."""
        return self.values


Evidence = Comparison | FullViewComparison | Known


class Posterior:
    """Exact posterior: every set but "all attack" has its own entry. `joint` is [S, b, a]; between frames a is 0."""

    def __init__(self, n: int, *, switch_prob: float, modes: int = 1) -> None:
        """The prior over n vehicles. Memory and time grow as 2^n.

        Args:
            n: Vehicles.
            switch_prob: φ, the probability that L is drawn anew in a frame with an attack.
            modes: Number of attack modes.
        """
        self._begin(every_set(n), every_prior(n), switch_prob, modes)

    def _begin(self, sets: Sets, birth: Float[np.ndarray, " S"], switch_prob: float, modes: int) -> None:
        self.sets, self.prior, self.switch_prob = sets, birth, switch_prob
        self.joint = np.zeros((len(sets), modes + 1, modes + 1))
        self.joint[:, 0, 0] = self.prior

    @property
    def density(self) -> Density:
        """p(L, b)."""
        return self.joint.sum(2)

    @property
    def mass(self) -> Joint:
        """Probability of (L, b, a), summing to one. It is not written to."""
        return self.joint

    def predict(self, attack_probs: ModeProbs) -> None:
        """Begin a new frame, in which the attackers are active with probability `attack_probs[mode - 1]`."""
        self.joint = predicted(self.density, self.sets, self.prior, self.switch_prob, attack_probs)
        self._normalise()

    def update(self, evidence: Evidence) -> None:
        """Condition on one similarity of this frame."""
        self.joint = np.multiply(self.joint, evidence.likelihood(self.sets), order="C")
        self._normalise()

    def advance(self, renew: bool) -> None:
        """End the frame. With `renew`, its views are the references from now on; else the references stay."""
        self.joint = settled(ended(self.joint, renew))

    def attack_probs(self) -> ModeProbs:
        """Probability of an attack in this frame, by mode."""
        probs: ModeProbs = self.mass[self.sets.any(1), :, 1:].sum((0, 1))
        return probs

    def attacker_probability(self) -> Float[np.ndarray, " n"]:
        """Probability that each vehicle is an attacker."""
        return self.mass.sum((1, 2)) @ self.sets

    def likeliest(self) -> float:
        """Probability of the likeliest set."""
        return float(self.mass.sum((1, 2)).max())

    def uncontaminated_probability(self, groups: Bool[np.ndarray, "X n"], *, now: bool) -> Float[np.ndarray, " X"]:
        """Probability that each group's view, of this frame or of the references' frame, is uncontaminated."""
        attacked = self.mass.sum(1 if now else 2)[:, 1:].sum(1)
        contaminated = groups @ self.sets.T | ~self.sets.any(1)
        return 1 - (contaminated * attacked).sum(1)

    def _normalise(self) -> None:
        self.joint = self.joint / self.mass.sum()


@lru_cache(LISTS)
def every_set(n: int) -> Sets:
    """All sets of attackers among n vehicles but that of all, in the order of their members' bits. Read-only."""
    codes = np.arange(max(2**n - 1, 1))
    return read_only((codes[:, None] >> np.arange(n) & 1).astype(bool))


@lru_cache(LISTS)
def every_prior(n: int) -> Float[np.ndarray, " S"]:
    """Prior of each of `every_set`. Read-only."""
    return read_only(prior(every_set(n)))


def prior(sets: Sets) -> Float[np.ndarray, " S"]:
    """Prior of each set: uniform over the number of attackers 0 … n - 1, then uniform over the sets of that number."""
    n = sets.shape[1]
    by_number = np.array([1 / (max(n, 1) * comb(n, k)) for k in range(n)] + [0.0])
    return by_number[sets.sum(1)]


def predicted(
    density: Density, sets: Sets, birth: Float[np.ndarray, " S"], switch_prob: float, attack_probs: ModeProbs
) -> Joint:
    """p(L, b, a) before any view of the frame, from p(L, b); not normalised."""
    joint = density[:, :, None] * np.array([1 - attack_probs.sum(), *attack_probs])
    joint[:, :, 1:] *= 1 - switch_prob
    joint[:, 0, 1:] += switch_prob * attack_probs * birth[:, None]
    joint[~sets.any(1), :, 1:] *= OUTLIER_PRIOR[: len(attack_probs)]
    return joint


def ended(joint: Joint, renew: bool) -> Density:
    """p(L, b) for the next frame: b is a of this one if the references are renewed."""
    return joint.sum(1 if renew else 2)


def settled(density: Density) -> Joint:
    """The joint between two frames."""
    joint = np.zeros((*density.shape, density.shape[1]))
    joint[:, :, 0] = density
    return joint
