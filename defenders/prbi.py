"""PRBI, Algorithm 1 of "All Vehicles Can Lie": two random groups a frame, counts, Bayes, and a t-test to stop."""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Mapping

import numpy as np

from defenders.evidence import check_knobs, estimate_liars, posterior, round_liars, settled
from defenders.protocol import Defender, Frame, Inspection, Query, Verdict, View
from defenders.readings import ROUNDINGS, Reading, check_choice
from defenders.thresholds import open_thresholds

Group = frozenset[int]
Views = dict[Group, View]


class Prbi(Defender):
    """Pseudo-Random Bayesian Inference. Line and equation numbers in the code are the paper's (Sec. 4, Algorithm 1).

    Where the paper is silent, or says two things:

    * Passing means similarity >= ε ("exceeds ε", line 17; "falls below ε" is abnormal, line 11).
    * Ties in argsort are broken at random, by one draw a frame: the Attackers of a frame (line 24) are the first
      group of the next (line 13), as both are the head of the same argsort.
    * ⌊m⌋ = 0 leaves Group_1 empty and everyone in Group_2. Nothing is asked: that view was already seen to be abnormal.
      It counts as a validation that all failed, as the proof of Theorem 1 (1) needs.
    * P(A) = 0, posterior above 1: see `evidence.posterior`. w_p = 1, S = 0: see `evidence.settled`.
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
    * In the frame of convergence the Attackers are excluded at once. Afterwards nothing is verified any more (line 11),
      so a vehicle that starts lying later is not noticed.
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
        reading: Reading | None = None,
    ) -> None:
        """Defaults are those of Sec. 11.1.

        epsilon     ε, the similarity below which a view is abnormal
        window      w, how many values of m the t-test looks at
        alpha       α, its confidence level
        gamma, lam  γ and λ, weights of the last posterior and of the normal ratio in the prior, Eq. (12)
        threshold   "paper": ε for every group; "calibrated": one per group size, shipped; or a mapping from size to ε
        rounding    "floor", "nearest" or "ceiling", of m when vehicles are grouped and accused: see Theorem 2
        stopping    "paper": both conditions of convergence; "never": go on verifying, to watch m
        """
        check_knobs(window=window, alpha=alpha, gamma=gamma, lam=lam)
        check_choice("rounding", rounding, ROUNDINGS)
        check_choice("stopping", stopping, ("paper", "never"))
        self.window, self.alpha, self.gamma, self.lam = window, alpha, gamma, lam
        self.epsilon = open_thresholds(threshold, epsilon)
        self.rounding, self.stopping = rounding, stopping
        self.reading = reading or Reading()

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        """Lines 1-3. ValueError below the two vehicles of Sec. 3.2."""
        if n_vehicles < 2:
            raise ValueError(f"PRBI splits at least 2 vehicles into groups, got {n_vehicles}; use the defender 'none'")
        self.everyone: Group = frozenset(range(n_vehicles))
        self.rng = rng
        self.normal = np.zeros(n_vehicles, dtype=np.int64)  # c_normal
        self.total = np.zeros(n_vehicles, dtype=np.int64)  # N
        self.m = n_vehicles - 1.0
        self.probability = np.zeros(n_vehicles)  # P_benign
        self.order = rng.permutation(n_vehicles)  # argsort(P_benign)
        self.history: deque[float] = deque(maxlen=self.window)  # W
        self.converged = False
        self.attackers: Group = frozenset()
        self.reference: View | None = None
        self.searched = False  # the divide and conquer belongs to the first abnormal frame

    def inspect(self, frame: Frame) -> Inspection:
        if self.converged:
            return self._exclude_attackers()  # line 41
        if self.reference is None:
            self.reference = frame.seen  # lines 6-10: the first frame is trusted
            return Verdict(self.everyone)
        views: Views = {self.everyone: frame.seen}
        if self._passes(frame, self.everyone, views):  # line 11
            verdict = self._exclude_attackers()
            self.reference = yield from self._perceive(verdict.collaborators, views)
            return verdict
        groups = self._soft_sampling()
        yield from self._validate(frame, groups, views)
        self._evaluate()
        self.history.append(self.m)  # line 26
        self.converged = self._is_settled()  # lines 27-28
        if self.converged:
            return self._exclude_attackers()
        return (yield from self._collaborate(frame, groups, views))

    def belief(self) -> np.ndarray:
        """1 - P_benign, as in Fig. 5, clipped to [0, 1]; zeros before the first abnormal frame."""
        return 1 - np.clip(self.probability, 0, 1) if self.total.any() else np.zeros(len(self.everyone))

    def _soft_sampling(self) -> list[Group]:
        """Eq. (6), lines 13-14: the ⌊m⌋ most suspicious vehicles, and the others. Empty groups are left out."""
        cut = round_liars(self.m, self.rounding)
        groups = [frozenset(part.tolist()) for part in (self.order[:cut], self.order[cut:])]
        return [group for group in groups if group]

    def _validate(self, frame: Frame, groups: list[Group], views: Views) -> Generator[Query, list[View], None]:
        """Consistency validation, lines 16-18."""
        asked = [group for group in groups if group not in views]
        if asked:
            views.update(zip(asked, (yield Query(asked)), strict=True))
        for group in groups:
            self.normal[list(group)] += self._passes(frame, group, views)
        self.total += 1

    def _evaluate(self) -> None:
        """Attacker evaluation, lines 20-24."""
        self.m = estimate_liars(self.normal, self.total)
        self.probability = posterior(self.probability, self.normal, self.total, gamma=self.gamma, lam=self.lam)
        shuffled = self.rng.permutation(len(self.order))
        ranks = np.argsort(self.probability[shuffled], kind="stable")  # ties as they were shuffled
        self.order = shuffled[ranks]
        self.attackers = frozenset(self.order[: round_liars(self.m, self.rounding)].tolist())  # Eq. (13)

    def _is_settled(self) -> bool:
        """Line 27: Eq. (14), and as many vehicles of probability zero as there are liars by m."""
        if self.stopping == "never":
            return False
        mean = self.m if self.reading.mean == "m" else round_liars(self.m, "floor")
        zeros = int(np.count_nonzero(self.probability == 0))
        return zeros == round_liars(self.m, self.reading.second) and settled(self.history, mean, self.alpha)

    def _collaborate(self, frame: Frame, groups: list[Group], views: Views) -> Inspection:
        """Lines 31-38: whom to fuse while unsure; their view is the output and the next reference."""
        collaborators: Group = frozenset(np.flatnonzero(self.probability).tolist())  # line 31
        if not collaborators and not self.searched:
            collaborators = yield from self._divide_and_conquer(frame, groups, views)  # line 33
        self.searched = True
        if not collaborators:
            verified = [group for group in views if group != self.everyone] or [self.everyone]
            collaborators = max(verified, key=lambda group: frame.similarity(views[group], self.reference))
        else:
            self.reference = yield from self._perceive(collaborators, views)  # lines 36-37
        return Verdict(collaborators, self.attackers - collaborators)

    def _divide_and_conquer(
        self, frame: Frame, failed: list[Group], views: Views
    ) -> Generator[Query, list[View], Group]:
        """Lines 33-34: the first subset that passes, and its counts; empty if there is none."""
        found: Group = frozenset()
        stack = sorted(failed, key=len)
        while stack and not found:
            members = [i for i in self.order.tolist() if i in stack[-1]]
            stack.pop()
            if len(members) == 1:
                continue
            halves = [frozenset(members[: len(members) // 2]), frozenset(members[len(members) // 2 :])]
            views.update(zip(halves, (yield Query(halves)), strict=True))
            passed = [half for half in halves if self._passes(frame, half, views)]
            found = passed[0] if passed else found
            self._count_halves(halves, passed)
            stack += reversed(halves)
        if found and self.reading.split in ("once", "replace"):
            self.normal[list(found)] += 1
            self.total += self.reading.split == "once"
        if self.reading.refresh:
            self._evaluate()
            self.history[-1] = self.m
        return found

    def _count_halves(self, halves: list[Group], passed: list[Group]) -> None:
        if self.reading.split in ("halves", "members"):
            counted = self.everyone if self.reading.split == "halves" else halves[0] | halves[1]
            self.total[list(counted)] += 1
            for half in passed:
                self.normal[list(half)] += 1

    def _perceive(self, group: Group, views: Views) -> Generator[Query, list[View], View]:
        """The view of the group that is fused for the output: no verification, since the ego perceives it anyway."""
        if group not in views:
            (views[group],) = yield Query([group], verification=False)
        return views[group]

    def _passes(self, frame: Frame, group: Group, views: Views) -> bool:
        return frame.similarity(views[group], self.reference) >= self.epsilon(group)

    def _exclude_attackers(self) -> Verdict:
        return Verdict(self.everyone - self.attackers, self.attackers, self.converged)
