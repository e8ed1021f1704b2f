"""A posterior over sets of liars, and over whether they were at work when the reference was seen.

A hypothesis is a set L of liars. The number of liars is uniform on 0 … n - 1 and the set is uniform given its number.
In each frame the liars are at work, all of them and in one manner (a = 1, 2, …), with probability q_a, or pause
(a = 0); and so it was in the frame the reference comes from (b). Lies are likelier after lies of their manner: q_a is
between its equal share of STARTS and its own STAYS, by the probability that the frame before held such lies. If nobody
lies, a > 0 is a glitch, in which lies seem to show whoever is in a view (beside the free view of the frame they seldom
do: `likelihood.ODD`): as rare as g_a says, and without a share given back to a = 0, so that a frame in which nothing
shows says nothing about L: who pauses is not acquitted. In a frame with lies, L is drawn anew with probability φ:
somebody may start to lie, and no verdict is for ever. Liars who have just started were honest in the reference.

    p(L, b, a = 0) ∝ (1 - Σ q_a) p(L, b)
    p(L, b, a > 0) ∝ q_a ((1 - φ) p(L, b) + φ p₀(L) [b = 0]) (g_a if L = ∅ else 1)

The recursion is pointwise in L: it needs of the other sets nothing but the normaliser.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb

import numpy as np
from jaxtyping import Bool, Float

from defenders.bayes.likelihood import BesideTable, Table

GLITCH = np.array([0.05, 4.0])  # g_a, by manner: streets in which honest views agree little are not rare
STARTS = 0.02  # Σ q after a pause
STAYS = np.array([0.7, 0.85])  # q of a manner after a frame with such lies: to stop resembling the last shows

Sets = Bool[np.ndarray, "S n"]
Density = Float[np.ndarray, "S A"]
Joint = Float[np.ndarray, "S A A"]  # A manners, that of honest vehicles among them: 0
Chances = Float[np.ndarray, " manners"]  # of every manner of lies


@dataclass(frozen=True, eq=False)
class Comparison:
    """A similarity, binned, of the view of a group to a reference."""

    group: Bool[np.ndarray, " n"]
    reference: Bool[np.ndarray, " n"]
    table: Table  # of the reference's age
    bin: int

    def likelihood(self, sets: Sets) -> Joint:
        """Probability of the similarity under every (L, b, a)."""
        size, reference = int(self.group.sum()), int(self.reference.sum())
        shared = int((self.group & self.reference).sum())
        honest, nobody = np.zeros(len(sets), dtype=np.int64), ~sets.any(1)
        now = np.where(nobody, -1, sets[:, self.group].sum(1))
        then = np.where(nobody, -1, sets[:, self.reference].sum(1))
        values, manners = self.table.density[:, self.bin], range(self.table.manners + 1)
        rows = [
            [
                self.table.rows(size, now if a else honest, reference, then if b else honest, shared, a, b)
                for a in manners
            ]
            for b in manners
        ]
        return np.moveaxis(values[np.array(rows)], 2, 0)


@dataclass(frozen=True, eq=False)
class Beside:
    """A similarity, binned, of the view of a group to the free one of the same frame, of all present."""

    group: Bool[np.ndarray, " n"]
    present: Bool[np.ndarray, " n"]
    table: BesideTable  # of so many present
    bin: int

    def likelihood(self, sets: Sets) -> Joint:
        """Probability of the similarity under every (L, b, a); b says nothing about it."""
        lying = np.where(sets.any(1), sets[:, self.present].sum(1), -1)
        liars, nobody = sets[:, self.group].sum(1), np.zeros(len(sets), dtype=np.int64)
        size, manners = int(self.group.sum()), range(1, self.table.manners + 1)
        rows = [self.table.rows(size, nobody, nobody), *(self.table.rows(size, liars, lying, a) for a in manners)]
        values = self.table.density[:, self.bin][np.stack(rows, axis=1)]
        return np.repeat(values[:, None], self.table.manners + 1, axis=1)


Evidence = Comparison | Beside


class Posterior:
    """Exact: every set but "all lie" has its own entry. `joint` [S, b, a]; between frames a is not known and 0."""

    def __init__(self, n: int, *, turn: float, manners: int = 1) -> None:
        """`turn` is φ, `manners` are those of lies. Memory and time grow as 2^n."""
        codes = np.arange(max(2**n - 1, 1))
        self._begin((codes[:, None] >> np.arange(n) & 1).astype(bool), turn, manners)

    def _begin(self, sets: Sets, turn: float, manners: int) -> None:
        self.sets, self.turn = sets, turn
        self.prior = prior(sets)
        self.scale: Float[np.ndarray, " S"] = np.ones(len(sets))  # what a point of the density stands for
        self.joint = np.zeros((len(sets), manners + 1, manners + 1))
        self.joint[:, 0, 0] = self.prior

    @property
    def density(self) -> Density:
        """p(L, b), up to `scale`."""
        return self.joint.sum(2)

    @property
    def mass(self) -> Joint:
        """Probability of (L, b, a), summing to one."""
        return self.joint * self.scale[:, None, None]

    def predict(self, lying: Chances) -> None:
        """A new frame begins, in which the liars are at work with probability `lying`, for each manner."""
        self.joint = predicted(self.density, self.sets, self.prior, self.turn, lying)
        self._normalise()

    def update(self, evidence: Evidence) -> None:
        """Take in one similarity of this frame."""
        self.joint *= evidence.likelihood(self.sets)
        self._normalise()

    def advance(self, renew: bool) -> None:
        """The frame ends. `renew`: its views are the references from now on, else those there were stay."""
        self.joint = settled(ended(self.joint, renew))

    def lies(self) -> Chances:
        """Probability that somebody is lying in this frame, in each manner."""
        chances: Chances = self.mass[self.sets.any(1), :, 1:].sum((0, 1))
        return chances

    def guilt(self) -> Float[np.ndarray, " n"]:
        """Probability that each vehicle is a liar."""
        return self.mass.sum((1, 2)) @ self.sets

    def likeliest(self) -> float:
        """Probability of the likeliest set."""
        return float(self.mass.sum((1, 2)).max())

    def clean(self, group: Bool[np.ndarray, " n"], *, now: bool) -> float:
        """Probability that nobody was lying in the view of a group, of this frame or of the references' frame."""
        over = self.mass.sum(1 if now else 2)  # [S, a] or [S, b]
        caught = (self.sets & group).any(1) | ~self.sets.any(1)
        return float(1 - over[caught, 1:].sum())

    def _normalise(self) -> None:
        self.joint /= self.mass.sum()


def prior(sets: Sets) -> Float[np.ndarray, " S"]:
    """Probability of each set: uniform over the number of liars 0 … n - 1, then uniform over sets; 0 where all lie."""
    n = sets.shape[1]
    by_number = np.array([1 / (max(n, 1) * comb(n, k)) for k in range(n)] + [0.0])
    return by_number[sets.sum(1)]


def predicted(density: Density, sets: Sets, birth: Float[np.ndarray, " S"], turn: float, lying: Chances) -> Joint:
    """p(L, b, a) before anything is seen of the frame, from p(L, b); not normalised."""
    joint = density[:, :, None] * np.array([1 - lying.sum(), *lying])
    joint[:, :, 1:] *= 1 - turn
    joint[:, 0, 1:] += turn * lying * birth[:, None]
    joint[~sets.any(1), :, 1:] *= GLITCH[: len(lying)]
    return joint


def ended(joint: Joint, renew: bool) -> Density:
    """p(L, b) for the next frame: b is a of this one if the references are renewed."""
    return joint.sum(1 if renew else 2)


def settled(density: Density) -> Joint:
    """The joint between two frames."""
    joint = np.zeros((*density.shape, density.shape[1]))
    joint[:, :, 0] = density
    return joint
