"""PRBI, Algorithm 1 of "All Vehicles Can Lie": two random groups a frame, counts, Bayes, and a test to stop."""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Mapping

import numpy as np

from defenders.checks import check_choice
from defenders.prbi.frame_views import Asking, Group, Looks, union
from defenders.prbi.group_testing import Proof
from defenders.prbi.inference import check_knobs, estimate_liars, posterior, round_liars, settled
from defenders.prbi.interpretation import ROUNDINGS, STOPPINGS, Reading
from defenders.protocol import Defender, Frame, Inspection, Query, Verdict, View
from defenders.thresholds.tables import open_thresholds


class Prbi(Defender):
    """Pseudo-Random Bayesian Inference. Line and equation numbers in the code are the paper's (Sec. 4, Algorithm 1).

    Where the paper is silent, or says two things (docs/prbi.md tells more):

    * Passing means similarity >= ε ("exceeds ε", line 17; "falls below ε" is abnormal, line 11).
    * Ties in argsort are broken at random, by one draw a frame: the Attackers of a frame (line 24) are the first
      group of the next (line 13), as both are the head of the same argsort.
    * ⌊m⌋ = 0 leaves Group_1 empty and everyone in Group_2. Nothing is asked: that view was already seen to be abnormal.
      It counts as a validation that all failed, as the proof of Theorem 1 (1) needs.
    * P(A) = 0, posterior above 1: see `evidence.posterior`. w_p = 1, S = 0: see `evidence.settled`.
    * Collaborators are fused in this frame (Algorithm 1, Sec. 4.3), not in the next (step 4 of Sec. 4.2).
    * The reference is renewed by the output of every frame before convergence, normal ones too: a stale reference
      drifts below ε by motion alone.
    * A normal frame before convergence excludes the Attackers of the last evaluation (line 41, taken literally); there
      are none before the first abnormal frame, and then everyone is fused.
    * Accused before convergence are the Attackers, Eq. (13), except those fused as collaborators (P_benign > 0).
    * The first abnormal frame's divide and conquer halves the larger failed group first, verifies both halves, and
      goes depth first to the first half that passes; a single vehicle is not halved. What it adds to the counts:
      see `readings.Reading`.
    * No vehicle of probability above zero, and none found: the most similar of this frame's views is the output, and
      the reference stays, since nothing was verified.
    * Who is absent is neither sampled nor counted, and keeps the counts it had; where none of those to be fused is
      present, the ego alone is.
    * In the frame of convergence the Attackers are excluded at once. Afterwards nothing is verified any more (line 11),
      so a vehicle that starts lying later is not noticed: see `rearm`.

    `stopping="robust"` keeps the counts, m and P_benign, and stops on proof (`proof.Proof`) instead of Eq. (14):

    * Converged is when everyone is cleared or convicted; accused are the convicted and fused are the cleared.
    * Soft sampling, Eq. (6), divides those not convicted, and Group_2 always holds someone open: at most all but one of
      the open are Group_1. After a frame that settled nobody, each group is the cleared and one who is open, so n
      frames are enough however slowly m moves.
    * The search for a clean subset is made whenever nobody is cleared, not in the first abnormal frame only.
    * The cleared are fused only if their view passes; else the largest group that passed in this frame is.
    * When no group at all resembles the reference, twice in a row, the reference is what is wrong (the first frame was
      a lie): the view that most resembles those of disjoint groups takes its place, and the counting starts over.
    """

    def __init__(
        self,
        *,
        epsilon: float = 0.35,
        window: int = 10,
        alpha: float = 0.01,
        gamma: float = 0.35,
        lam: float = 0.65,
        threshold: str | Mapping[int, float] = "paper",
        rounding: str = "floor",
        stopping: str = "paper",
        rearm: bool = False,
        reading: Reading | None = None,
    ) -> None:
        """Defaults are those of Sec. 11.1.

        epsilon     ε, the similarity below which a view is abnormal
        window      w, how many values of m the t-test looks at
        alpha       α, its confidence level
        gamma, lam  γ and λ, weights of the last posterior and of the normal ratio in the prior, Eq. (12)
        threshold   "paper": ε for every group; "calibrated": one per group size, shipped for each fusion (see
                    `configure`); or a mapping from size to ε
        rounding    "floor", "nearest" or "ceiling", of m when vehicles are grouped and accused: see Theorem 2
        stopping    "paper": both conditions of convergence; "robust": proof; "never": go on verifying, to watch m
        rearm       whether the output is compared with the one before after convergence, too. If it is abnormal, the
                    algorithm starts over; who was convicted stays excluded, and first to be suspected, until it passes
        reading     what the paper's text leaves open
        """
        check_knobs(window=window, alpha=alpha, gamma=gamma, lam=lam)
        check_choice("rounding", rounding, ROUNDINGS)
        check_choice("stopping", stopping, STOPPINGS)
        self.window, self.alpha, self.gamma, self.lam = window, alpha, gamma, lam
        self.epsilon = open_thresholds(threshold, epsilon)
        self.rounding, self.stopping, self.rearm = rounding, stopping, rearm
        self.reading = reading or Reading()

    def configure(self, *, fusion: str) -> None:
        self.epsilon = self.epsilon.of(fusion)

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        """ValueError below the two vehicles of Sec. 3.2."""
        if n_vehicles < 2:
            raise ValueError(f"PRBI splits at least 2 vehicles into groups, got {n_vehicles}; use the defender 'none'")
        self.everyone: Group = frozenset(range(n_vehicles))
        self.rng, self.present = rng, self.everyone
        self.reference: View | None = None
        self.lost = 0  # abnormal frames running in which no group passed
        self._begin(attackers=frozenset())

    def _begin(self, attackers: Group) -> None:
        """Lines 1-3. `attackers` were convicted before, and stay accused until they pass."""
        n = len(self.everyone)
        self.normal = np.zeros(n, dtype=np.int64)  # c_normal
        self.total = np.zeros(n, dtype=np.int64)  # N
        self.m = n - 1.0
        self.probability = np.zeros(n)  # P_benign
        self.history: deque[float] = deque(maxlen=self.window)  # W
        self.converged = False
        self.attackers = self.known = attackers
        self.order = self._argsort()
        self.searched = False  # the divide and conquer belongs to the first abnormal frame
        self.proof = Proof(n)
        self.stalled = False  # whether the last abnormal frame proved nothing

    def inspect(self, frame: Frame) -> Inspection:
        self.present = frame.present
        if self.reference is None:
            self.reference = frame.seen  # lines 6-10: the first frame is trusted
            return Verdict(self.everyone)
        looks = Looks(frame, self.reference, self.epsilon)
        if self.converged:
            verdict = self._exclude_attackers()  # line 41
            if not self.rearm or (yield from self._renew(looks, verdict.collaborators)):
                return verdict
            yield from looks.reject(verdict.collaborators)
            self._begin(self.attackers)
        elif looks.passes(self.present):  # line 11
            verdict = self._exclude_attackers()
            yield from self._output(looks, verdict.collaborators)
            return verdict
        groups = self._soft_sampling()
        yield from self._validate(looks, groups)
        self._evaluate()
        self.history.append(self.m)  # line 26
        self.converged = self._is_settled()  # lines 27-28
        if not self.converged:
            return (yield from self._collaborate(looks, groups))
        verdict = self._exclude_attackers()
        if self.rearm:
            yield from self._renew(looks, verdict.collaborators)
        return verdict

    def belief(self) -> np.ndarray:
        """1 - P_benign, as in Fig. 5, clipped to [0, 1]; zeros before the first abnormal frame."""
        return 1 - np.clip(self.probability, 0, 1) if self.total.any() else np.zeros(len(self.everyone))

    def _soft_sampling(self) -> list[Group]:
        """Eq. (6), lines 13-14: the ⌊m⌋ most suspicious vehicles, and the others. Empty groups are left out."""
        order = [i for i in self.order.tolist() if i in self.present]
        cut = round_liars(self.m, self.rounding)
        if self.stopping == "robust":
            unsure, cleared = ([i for i in order if i in some] for some in (self.proof.open, self.proof.cleared))
            if self.stalled and cleared:
                return [frozenset((*cleared, i)) for i in unsure[-2:]]
            order = unsure + cleared
            cut = max(min(cut - len(self.proof.convicted), len(unsure) - 1), 0)
        return [frozenset(part) for part in (order[:cut], order[cut:]) if part]

    def _validate(self, looks: Looks, groups: list[Group]) -> Asking:
        """Consistency validation, lines 16-18."""
        yield from looks.verify(groups)
        self.normal[list(union(group for group in groups if looks.passes(group)))] += 1
        self.total[list(self.present)] += 1
        if self.stopping == "robust":
            self.stalled = not self.proof.learn(looks.verdicts())

    def _evaluate(self) -> None:
        """Attacker evaluation, lines 20-24."""
        self.m = estimate_liars(self.normal, self.total)
        self.probability = posterior(self.probability, self.normal, self.total, gamma=self.gamma, lam=self.lam)
        self.known -= frozenset(np.flatnonzero(self.normal).tolist())
        self.order = self._argsort()
        self.attackers = self._accused()

    def _argsort(self) -> np.ndarray:
        """argsort(P_benign). Of equals, those convicted before come first, and the rest as `reading.ties` says."""
        n = len(self.everyone)
        ties = self.rng.permutation(n) if self.reading.ties == "random" else np.arange(n)
        if not self.known:
            return ties[self.probability[ties].argsort(kind="stable")]
        unknown = np.array([i not in self.known for i in ties.tolist()])
        order: np.ndarray = ties[np.lexsort((unknown, self.probability[ties]))]
        return order

    def _accused(self) -> Group:
        """Eq. (13), or who is proved to lie; and who was convicted before and not cleared since, unless that is all."""
        if self.stopping != "robust":
            return self.known.union(self.order[: round_liars(self.m, self.rounding)].tolist())
        convicted = self.proof.convicted
        return self.known | convicted if self.known | convicted < self.everyone else convicted

    def _is_settled(self) -> bool:
        """Line 27: Eq. (14), and as many vehicles of probability zero as there are liars by m; or proof."""
        if self.stopping != "paper":
            return self.stopping == "robust" and not self.proof.open
        mean = self.m if self.reading.mean == "m" else round_liars(self.m, "floor")
        zeros = int(np.count_nonzero(self.probability == 0))
        return zeros == round_liars(self.m, self.reading.second) and settled(self.history, mean, self.alpha)

    def _collaborate(self, looks: Looks, groups: list[Group]) -> Inspection:
        """Lines 31-38: whom to fuse while unsure; their view is the output and the next reference."""
        collaborators: Group = yield from self._trusted(looks)
        if not collaborators and not self.searched:
            collaborators = yield from self._divide_and_conquer(looks, groups)  # line 33
        self.searched = self.stopping != "robust"
        self.lost = 0 if collaborators else self.lost + 1
        if collaborators:
            yield from self._output(looks, collaborators)  # lines 36-37
        else:
            collaborators = self._least_evil(looks)
        return Verdict(collaborators, self.attackers - collaborators)

    def _trusted(self, looks: Looks) -> Generator[Query, list[View], Group]:
        """Line 31; or the cleared, if their view passes, or else the largest group that does; empty if nobody is."""
        if self.stopping != "robust":
            return self.present.intersection(np.flatnonzero(self.probability).tolist())
        cleared = self.proof.cleared & self.present
        if cleared:
            yield from looks.perceive(cleared)
            if looks.passes(cleared):
                return cleared
            yield from looks.reject(cleared)
            self.proof.learn(looks.verdicts())
        return max((group for group, passed in looks.verdicts().items() if passed), key=len, default=frozenset())

    def _divide_and_conquer(self, looks: Looks, failed: list[Group]) -> Generator[Query, list[View], Group]:
        """Lines 33-34: the first subset that passes, and its counts; empty if there is none."""
        found: Group = frozenset()
        stack = sorted(failed, key=len)
        while stack and not found:
            members = [i for i in self.order.tolist() if i in stack[-1]]
            stack.pop()
            if len(members) == 1:
                continue
            halves = [frozenset(members[: len(members) // 2]), frozenset(members[len(members) // 2 :])]
            yield from looks.verify(halves)
            passed = [half for half in halves if looks.passes(half)]
            found = passed[0] if passed else found
            self._count_halves(halves, passed)
            stack += reversed(halves)
        if found and self.reading.split in ("once", "replace"):
            self.normal[list(found)] += 1
            self.total[list(self.present)] += self.reading.split == "once"
        if self.stopping == "robust":
            self.proof.learn(looks.verdicts())
        if self.reading.refresh:
            self._evaluate()
            self.history[-1] = self.m
        return found

    def _count_halves(self, halves: list[Group], passed: list[Group]) -> None:
        if self.reading.split in ("halves", "members"):
            counted = self.present if self.reading.split == "halves" else union(halves)
            self.total[list(counted)] += 1
            self.normal[list(union(passed))] += 1

    def _least_evil(self, looks: Looks) -> Group:
        """No group passed: the most similar is the output. Twice running, "robust" mistrusts the reference instead."""
        groups = list(looks.views)[1:] or [self.present]
        if self.stopping != "robust" or self.lost < 2:
            return max(groups, key=looks.likeness)
        group = max(groups, key=lambda group: (looks.support(group), -len(group)))
        self.reference = looks.views[group]
        self._begin(attackers=frozenset())
        return group

    def _output(self, looks: Looks, group: Group) -> Asking:
        """Fuse the group: its view is the next reference."""
        yield from looks.perceive(group)
        self.reference = looks.views[group]

    def _renew(self, looks: Looks, group: Group) -> Generator[Query, list[View], bool]:
        """Fuse the group; its view is the next reference if it passes. Returns whether it does."""
        yield from looks.perceive(group)
        if normal := looks.passes(group):
            self.reference = looks.views[group]
        return normal

    def _exclude_attackers(self) -> Verdict:
        fused = self.present - self.attackers or frozenset({0})
        return Verdict(fused, self.attackers - fused, self.converged)
