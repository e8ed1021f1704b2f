"""PASAC, the sampling of CP-Guard (AAAI 2025): halve failing groups until every part passes or is one vehicle."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from defenders.checks import check_choice
from defenders.protocol import Defender, Frame, Inspection, Query, Verdict, View
from defenders.thresholds.tables import EGO_ONLY, open_thresholds

Group = frozenset[int]
PAPER = {"agreement": 0.08, "similarity": 0.3}  # CP-Guard's consistency of segmentation maps, CP-uniGuard's Jaccard


class Pasac(Defender):
    """Probability-agnostic sample consensus, anew in every frame. The reference is the ego-only view, not counted.

    The collaborators are halved at ⌊n/2⌋ in random order and both halves are verified. A half that passes (its score is
    above ε) is accepted whole, one that fails is halved in turn, and a single vehicle that fails is flagged. Everyone
    together is not verified. All halves of one depth are asked in one query, which changes the number of forwards and
    nothing else.

    Where the paper is silent: With `n_upper` one half is verified after the other, depth first, so that nothing is paid
    for after enough are accepted. A half that passes is accepted whole even if it is more than enough. A vehicle that
    was not verified or is absent is neither fused nor flagged. If nobody passes, the ego perceives alone, whether it is
    flagged or not.
    """

    max_queries = 128  # a tree over 64 vehicles, one node a query

    def __init__(
        self,
        *,
        score: str = "agreement",
        threshold: str | Mapping[int, float] = "calibrated",
        epsilon: float | None = None,
        visit_all: bool = False,
        n_upper: int | None = None,
        trust_ego: bool = True,
    ) -> None:
        """Build the defender.

        Args:
            score: "agreement": consistency of score maps (CCLoss). "similarity": Jaccard of boxes (CP-uniGuard).
            threshold: "calibrated": one ε for each size of the group that is fused, measured with the ego's detector.
                "paper": 0.08 for agreement, which was made for segmentation maps, and 0.3 for similarity. Or a
                calibration file, or a mapping from size to ε.
            epsilon: One ε for every size instead.
            visit_all: Verify all 2n - 1 nodes of the tree, the root and the parts of accepted parts too, as CP-uniGuard
                does. Then every member of a part that passes is accepted, and the others are flagged.
            n_upper: Number of accepted collaborators after which the search stops. The trusted ego does not count.
            trust_ego: As published: the ego is in every group and never flagged. False halves all vehicles, the ego
                too.

        Raises:
            ValueError: If an option is out of range.
        """
        check_choice("score", score, tuple(PAPER))
        if n_upper is not None and (n_upper < 1 or visit_all):
            raise ValueError(f"n_upper is how many are enough, at least 1, and not with visit_all; got {n_upper}")
        self.score, self.trust_ego, self.n_upper, self.visit_all = score, trust_ego, n_upper, visit_all
        self.epsilon = (
            open_thresholds(threshold, PAPER[score], EGO_ONLY[score])
            if epsilon is None
            else open_thresholds("paper", epsilon)
        )

    def configure(self, *, fusion: str) -> None:
        self.epsilon = self.epsilon.of(fusion)

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        self.n_vehicles, self.rng = n_vehicles, rng
        self.flagged: Group = frozenset()

    def inspect(self, frame: Frame) -> Inspection:
        ego: Group = frozenset({0}) if self.trust_ego else frozenset()
        (reference,) = yield Query([{0}], verification=False)
        order = self.rng.permutation(sorted(frame.present - ego)).tolist()
        accepted, failed = set(ego), set[int]()
        parts = [order] if self.visit_all or len(order) == 1 else halves(order) if order else []
        while parts and (self.n_upper is None or len(accepted - ego) < self.n_upper):
            now, parts = (parts, []) if self.n_upper is None else (parts[:1], parts[1:])
            groups = [ego.union(part) for part in now]
            deeper = []
            for part, group, view in zip(now, groups, (yield Query(groups)), strict=True):
                passed = self._is_consistent(frame, group, view, reference)
                accepted.update(part if passed else ())
                failed.update(part if len(part) == 1 and not passed else ())
                deeper += halves(part) if len(part) > 1 and (self.visit_all or not passed) else []
            parts = deeper + parts
        self.flagged = frozenset(failed - (accepted or {0}))
        return Verdict(accepted or {0}, self.flagged)

    def belief(self) -> np.ndarray:
        return np.array([float(i in self.flagged) for i in range(self.n_vehicles)])

    def _is_consistent(self, frame: Frame, group: Group, view: View, reference: View) -> bool:
        compare = frame.agreement if self.score == "agreement" else frame.similarity
        return compare(view, reference) > self.epsilon(group)


def halves(members: list[int]) -> list[list[int]]:
    """The first ⌊n/2⌋ and the rest."""
    return [members[: len(members) // 2], members[len(members) // 2 :]]
