"""PRBI, Algorithm 1 of "All Vehicles Can Lie": two random groups a frame, counts, Bayes, and a stopping test."""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Mapping

import numpy as np

from defenders.checks import check_choice
from defenders.prbi.first_split import even_split, independent_split
from defenders.prbi.frame_views import FrameViews, Group, Queries, union
from defenders.prbi.inference import check_options, estimate_attackers, posterior, round_attackers, settled
from defenders.prbi.interpretation import ROUNDINGS, STOPPINGS, Reading
from defenders.protocol import Defender, Frame, Inspection, Query, Verdict, View
from defenders.thresholds.tables import open_thresholds


class Prbi(Defender):
    """Pseudo-Random Bayesian Inference. Line and equation numbers in the code are the paper's (Sec. 4, Algorithm 1).

    Where the paper is silent or contradicts itself (see docs/prbi.md):

    * A group is consistent if its similarity is at least ε ("exceeds ε", line 17; below ε is abnormal, line 11).
    * Ties in argsort are broken at random, by one draw a frame. The Attackers of a frame (line 24) are the first group
      of the next (line 13), as both are the head of the same argsort.
    * ⌊m⌋ = 0 leaves Group_1 empty and everyone in Group_2. Nothing is queried, because that view is already known to be
      abnormal. It counts as a validation that all failed, as the proof of Theorem 1 (1) needs.
    * P(A) = 0, posterior above 1: see `inference.posterior`. w_p = 1, S = 0: see `inference.settled`.
    * Collaborators are fused in this frame (Algorithm 1, Sec. 4.3), not in the next (step 4 of Sec. 4.2).
    * The reference is renewed by the output of every frame before convergence, of normal frames too. A stale reference
      drifts below ε by motion alone.
    * A normal frame before convergence excludes the Attackers of the last evaluation (line 41, taken literally). There
      are none before the first abnormal frame, and then everyone is fused.
    * Flagged before convergence are the Attackers, Eq. (13), except those fused as collaborators (P_benign > 0).
    * The first abnormal frame's divide and conquer halves the larger failed group first and verifies both halves. It
      goes depth first to the first consistent half. A single vehicle is not halved. What it adds to the counts: see
      `interpretation.Reading`.
    * If no vehicle has a probability above zero and no subset is found, the most similar of this frame's views is the
      output. The reference stays, since nothing was validated.
    * An absent vehicle is neither sampled nor counted, and keeps its counts. If no vehicle to be fused is present, the
      ego alone is fused.
    * In the frame of convergence the Attackers are excluded at once. Afterwards nothing is verified any more (line 11).
      So a vehicle that attacks later is not noticed: see `rearm`.
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
        """Build the defender. The defaults are those of Sec. 11.1.

        Args:
            epsilon: ε, the similarity below which a view is abnormal.
            window: w, the number of values of m in the t-test.
            alpha: α, the level of the t-test.
            gamma: γ, the weight of the last posterior in the prior, Eq. (12).
            lam: λ, the weight of the normal ratio in the prior, Eq. (12).
            threshold: "paper": ε for every group. "calibrated": one ε for each group size, measured with the ego's
                detector (see `configure` and `cp-calibrate`). Or a calibration file, or a mapping from group size to ε.
            rounding: "floor", "nearest" or "ceiling" of m when vehicles are grouped and flagged (Theorem 2).
            stopping: "paper": both conditions of convergence. "never": go on verifying, to watch m.
            rearm: Whether the output is compared with the one before after convergence, too. If it is abnormal, the
                algorithm starts over. Convicted vehicles stay excluded, and are the first suspects, until they pass.
            reading: How ambiguities of the paper's text are read.

        Raises:
            ValueError: If an option is out of range.
        """
        check_options(window=window, alpha=alpha, gamma=gamma, lam=lam)
        check_choice("rounding", rounding, ROUNDINGS)
        check_choice("stopping", stopping, STOPPINGS)
        self.window, self.alpha, self.gamma, self.lam = window, alpha, gamma, lam
        self.epsilon = open_thresholds(threshold, epsilon)
        self.rounding, self.stopping, self.rearm = rounding, stopping, rearm
        self.reading = reading or Reading()

    def configure(self, *, fusion: str) -> None:
        self.epsilon = self.epsilon.of(fusion)

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        """Begin an episode. ValueError below the two vehicles of Sec. 3.2."""
        if n_vehicles < 2:
            raise ValueError(f"PRBI splits at least 2 vehicles into groups, got {n_vehicles}; use the defender 'none'")
        self.everyone: Group = frozenset(range(n_vehicles))
        self.rng, self.present = rng, self.everyone
        self.reference: View | None = None
        self.lost = 0  # abnormal frames in a row without a consistent group
        self._begin(attackers=frozenset())

    def _begin(self, attackers: Group) -> None:
        """Initialise, lines 1-3. `attackers` were convicted before, and stay flagged until they pass."""
        n = len(self.everyone)
        self.normal = np.zeros(n, dtype=np.int64)  # c_normal
        self.total = np.zeros(n, dtype=np.int64)  # N
        self.m = n - 1.0
        self.probability = np.zeros(n)  # P_benign
        self.history: deque[float] = deque(maxlen=self.window)  # W
        self.converged = False
        self.attackers = self.known = attackers
        self.order = self._argsort()
        self.drawn: list[int] = []  # the first abnormal frame's order, where the reading draws one
        self.searched = False  # the divide and conquer belongs to the first abnormal frame

    def inspect(self, frame: Frame) -> Inspection:
        self.present = frame.present
        if self.reference is None:
            self.reference = frame.seen  # lines 6-10: the first frame is trusted
            return Verdict(self.everyone)
        frame_views = FrameViews(frame, self.reference, self.epsilon)
        if self.converged:
            verdict = self._exclude_attackers()  # line 41
            if not self.rearm or (yield from self._renew(frame_views, verdict.collaborators)):
                return verdict
            yield from frame_views.reject(verdict.collaborators)
            self._begin(self.attackers)
        elif frame_views.is_consistent(self.present):  # line 11
            verdict = self._exclude_attackers()
            yield from self._output(frame_views, verdict.collaborators)
            return verdict
        groups = self._soft_sampling()
        yield from self._validate(frame_views, groups)
        self._evaluate()
        self.history.append(self.m)  # line 26
        self.converged = self._is_settled()  # lines 27-28
        if not self.converged:
            return (yield from self._collaborate(frame_views, groups))
        verdict = self._exclude_attackers()
        if self.rearm:
            yield from self._renew(frame_views, verdict.collaborators)
        return verdict

    def belief(self) -> np.ndarray:
        """Attack probability 1 - P_benign, as in Fig. 5, clipped to [0, 1]; zeros before the first abnormal frame."""
        return 1 - np.clip(self.probability, 0, 1) if self.total.any() else np.zeros(len(self.everyone))

    def _soft_sampling(self) -> list[Group]:
        """Soft sampling, Eq. (6): the ⌊m⌋ most suspicious vehicles, and the others. Empty groups are left out."""
        order = [i for i in self.order.tolist() if i in self.present]
        cut = round_attackers(self.m, self.rounding)
        groups = order[:cut], order[cut:]
        if self.reading.first != "m" and not self.total.any():
            groups = (even_split if self.reading.first == "even" else independent_split)(order, self.rng)
            self.drawn = [*groups[0], *groups[1]]
        return [frozenset(part) for part in groups if part]

    def _validate(self, frame_views: FrameViews, groups: list[Group]) -> Queries:
        """Consistency validation, lines 16-18."""
        yield from frame_views.verify(groups)
        self.normal[list(union(group for group in groups if frame_views.is_consistent(group)))] += 1
        self.total[list(self.present)] += 1
        self._learn(frame_views, validated=True)

    def _learn(self, frame_views: FrameViews, *, validated: bool) -> None:
        """Take in all views of the frame so far; `validated` after the soft sampling's, else after a search."""

    def _evaluate(self) -> None:
        """Attacker evaluation, lines 20-24."""
        self.m = estimate_attackers(self.normal, self.total)
        self.probability = posterior(self.probability, self.normal, self.total, gamma=self.gamma, lam=self.lam)
        self.known -= frozenset(np.flatnonzero(self.normal).tolist())
        self.order = self._argsort()
        self.attackers = self._flagged()

    def _argsort(self) -> np.ndarray:
        """argsort(P_benign). Of equals, vehicles convicted before come first, and the rest as `reading.ties` says."""
        n = len(self.everyone)
        ties = self.rng.permutation(n) if self.reading.ties == "random" else np.arange(n)
        if not self.known:
            return ties[self.probability[ties].argsort(kind="stable")]
        unknown = np.array([i not in self.known for i in ties.tolist()])
        order: np.ndarray = ties[np.lexsort((unknown, self.probability[ties]))]
        return order

    def _flagged(self) -> Group:
        """Flagged vehicles: Eq. (13), and those convicted before."""
        if self.reading.flagged == "zeros":
            return self.known.union(np.flatnonzero(self.probability == 0).tolist())
        return self.known.union(self.order[: round_attackers(self.m, self.rounding)].tolist())

    def _is_settled(self) -> bool:
        """Convergence, line 27: Eq. (14) and ⌊m⌋ vehicles of probability zero."""
        if self.stopping == "never":
            return False
        mean = self.m if self.reading.mean == "m" else round_attackers(self.m, "floor")
        zeros = int(np.count_nonzero(self.probability == 0))
        return zeros == round_attackers(self.m, self.reading.second) and settled(self.history, mean, self.alpha)

    def _collaborate(self, frame_views: FrameViews, groups: list[Group]) -> Inspection:
        """Collaborators before convergence, lines 31-38. Their view is the output and the next reference."""
        collaborators: Group = yield from self._trusted(frame_views)
        if not collaborators and not self.searched:
            collaborators = yield from self._divide_and_conquer(frame_views, groups)  # line 33
        self.searched = True
        self.lost = 0 if collaborators else self.lost + 1
        if collaborators:
            yield from self._output(frame_views, collaborators)  # lines 36-37
        else:
            collaborators = self._most_similar(frame_views)
        return Verdict(collaborators, self.attackers - collaborators)

    def _trusted(self, frame_views: FrameViews) -> Generator[Query, list[View], Group]:
        """Trusted vehicles, line 31: those whose probability is above zero, which costs nothing to know."""
        yield from ()
        return self.present.intersection(np.flatnonzero(self.probability).tolist())

    def _divide_and_conquer(self, frame_views: FrameViews, failed: list[Group]) -> Generator[Query, list[View], Group]:
        """Divide and conquer, lines 33-34: the first consistent subset, and its counts; empty if there is none."""
        found: Group = frozenset()
        stack = sorted(failed, key=len)
        while stack and not found:
            members = [i for i in self.drawn or self.order.tolist() if i in stack[-1]]
            stack.pop()
            if len(members) == 1:
                continue
            halves = [frozenset(members[: len(members) // 2]), frozenset(members[len(members) // 2 :])]
            yield from frame_views.verify(halves)
            passed = [half for half in halves if frame_views.is_consistent(half)]
            found = passed[0] if passed else found
            self._count_halves(halves, passed)
            stack += reversed(halves)
        if found and self.reading.split in ("once", "replace"):
            self.normal[list(found)] += 1
            self.total[list(self.present)] += self.reading.split == "once"
        self._learn(frame_views, validated=False)
        if self.reading.refresh:
            self._evaluate()
            self.history[-1] = self.m
        return found

    def _count_halves(self, halves: list[Group], passed: list[Group]) -> None:
        if self.reading.split in ("halves", "members"):
            counted = self.present if self.reading.split == "halves" else union(halves)
            self.total[list(counted)] += 1
            self.normal[list(union(passed))] += 1

    def _most_similar(self, frame_views: FrameViews) -> Group:
        """Output if no group is consistent: the most similar view of the frame."""
        return max(self._others(frame_views), key=frame_views.similarity)

    def _others(self, frame_views: FrameViews) -> list[Group]:
        """The groups that were verified in this frame; all present if there are none."""
        return list(frame_views.views)[1:] or [self.present]

    def _output(self, frame_views: FrameViews, group: Group) -> Queries:
        """Fuse the group. Its view is the next reference."""
        yield from frame_views.perceive(group)
        self.reference = frame_views.views[group]

    def _renew(self, frame_views: FrameViews, group: Group) -> Generator[Query, list[View], bool]:
        """Fuse the group. Its view is the next reference if it is consistent. Returns whether it is."""
        yield from frame_views.perceive(group)
        if normal := frame_views.is_consistent(group):
            self.reference = frame_views.views[group]
        return normal

    def _exclude_attackers(self) -> Verdict:
        fused = self.present - self.attackers or frozenset({0})
        return Verdict(fused, self.attackers - fused, self.converged)
