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
from math import comb

import numpy as np
from jaxtyping import Bool, Float

from defenders.bayes.likelihood import FullViewTable, Table

OUTLIER_PRIOR = np.array([0.05, 4.0])  # g_a, by mode: streets in which benign views agree little are not rare
ONSET_PROB = 0.02  # Σ q after a pause
PERSISTENCE_PROB = np.array([0.7, 0.85])  # q of a mode after a frame with such an attack; to end a stealthy one shows

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
        size, reference = int(self.group.sum()), int(self.reference.sum())
        shared = int((self.group & self.reference).sum())
        none, nobody = np.zeros(len(sets), dtype=np.int64), ~sets.any(1)
        now = np.where(nobody, -1, sets[:, self.group].sum(1))
        then = np.where(nobody, -1, sets[:, self.reference].sum(1))
        values, modes = self.table.density[:, self.bin], range(self.table.modes + 1)
        rows = [
            [self.table.rows(size, now if a else none, reference, then if b else none, shared, a, b) for a in modes]
            for b in modes
        ]
        return np.moveaxis(values[np.array(rows)], 2, 0)


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
        attackers, nobody = sets[:, self.group].sum(1), np.zeros(len(sets), dtype=np.int64)
        size, modes = int(self.group.sum()), range(1, self.table.modes + 1)
        rows = [self.table.rows(size, nobody, nobody), *(self.table.rows(size, attackers, total, a) for a in modes)]
        values = self.table.density[:, self.bin][np.stack(rows, axis=1)]
        return np.repeat(values[:, None], self.table.modes + 1, axis=1)


Evidence = Comparison | FullViewComparison


class Posterior:
    """Exact posterior: every set but "all attack" has its own entry. `joint` is [S, b, a]; between frames a is 0."""

    def __init__(self, n: int, *, switch_prob: float, modes: int = 1) -> None:
        """The prior over n vehicles. Memory and time grow as 2^n.

        Args:
            n: Vehicles.
            switch_prob: φ, the probability that L is drawn anew in a frame with an attack.
            modes: Number of attack modes.
        """
        codes = np.arange(max(2**n - 1, 1))
        self._begin((codes[:, None] >> np.arange(n) & 1).astype(bool), switch_prob, modes)

    def _begin(self, sets: Sets, switch_prob: float, modes: int) -> None:
        self.sets, self.switch_prob = sets, switch_prob
        self.prior = prior(sets)
        self.scale: Float[np.ndarray, " S"] = np.ones(len(sets))  # what a point of the density stands for
        self.joint = np.zeros((len(sets), modes + 1, modes + 1))
        self.joint[:, 0, 0] = self.prior

    @property
    def density(self) -> Density:
        """p(L, b), up to `scale`."""
        return self.joint.sum(2)

    @property
    def mass(self) -> Joint:
        """Probability of (L, b, a), summing to one."""
        return self.joint * self.scale[:, None, None]

    def predict(self, attack_probs: ModeProbs) -> None:
        """Begin a new frame, in which the attackers are active with probability `attack_probs[mode - 1]`."""
        self.joint = predicted(self.density, self.sets, self.prior, self.switch_prob, attack_probs)
        self._normalise()

    def update(self, evidence: Evidence) -> None:
        """Condition on one similarity of this frame."""
        self.joint *= evidence.likelihood(self.sets)
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

    def uncontaminated_probability(self, group: Bool[np.ndarray, " n"], *, now: bool) -> float:
        """Probability that a group's view, of this frame or of the references' frame, is uncontaminated."""
        over = self.mass.sum(1 if now else 2)  # [S, a] or [S, b]
        contaminated = (self.sets & group).any(1) | ~self.sets.any(1)
        return float(1 - over[contaminated, 1:].sum())

    def _normalise(self) -> None:
        self.joint /= self.mass.sum()


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
