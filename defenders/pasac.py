"""PASAC, the sampling of CP-Guard (AAAI 2025): halve whoever is in doubt until every part passes or is one vehicle."""

from __future__ import annotations

import numpy as np

from defenders.protocol import Defender, Frame, Inspection, Query, Verdict, View
from defenders.readings import check_choice

Group = frozenset[int]
THRESHOLDS = {"agreement": 0.08, "similarity": 0.3}  # as published: CP-Guard's loss, CP-uniGuard's Jaccard option


class Pasac(Defender):
    """Probability-agnostic sample consensus, anew in every frame; the ego's own view is the reference and not counted.

    The vehicles are halved at ⌊n/2⌋ in random order and both halves verified. A half that passes is accepted whole, one
    that fails is halved in turn, and a single vehicle that fails is accused. Verifying everyone together is left out.
    All halves of one depth are asked in one query, which changes the number of forwards and nothing else.

    Where the paper is silent: nobody passes, then the ego perceives alone, be it accused or not.
    """

    def __init__(
        self,
        *,
        score: str = "agreement",
        epsilon: float | None = None,
        trust_ego: bool = True,
        n_upper: int | None = None,
    ) -> None:
        """Build the defender.

        score      "agreement" (consistency of score maps, CCLoss) or "similarity" (Jaccard of boxes)
        epsilon    what passes is above it; by default 0.08 for agreement and 0.3 for similarity. The first was made for
                   segmentation: calibrate it on clean scenes before comparing.
        trust_ego  as published: the ego is in every group and never accused. False halves all vehicles, the ego too,
                   which is how PRBI's Table 2 counts.
        n_upper    stop once so many vehicles are accepted
        """
        check_choice("score", score, tuple(THRESHOLDS))
        if n_upper is not None and n_upper < 1:
            raise ValueError(f"n_upper is how many vehicles are enough, at least 1, got {n_upper}")
        self.score, self.trust_ego, self.n_upper = score, trust_ego, n_upper
        self.epsilon = THRESHOLDS[score] if epsilon is None else epsilon

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        self.n_vehicles, self.rng = n_vehicles, rng
        self.accused: Group = frozenset()

    def inspect(self, frame: Frame) -> Inspection:
        ego: Group = frozenset({0}) if self.trust_ego else frozenset()
        (reference,) = yield Query([{0}], verification=False)
        order = self.rng.permutation(np.arange(len(ego), self.n_vehicles)).tolist()
        accepted, accused = ego, set()
        parts = halves(order) if len(order) > 1 else [order]
        while parts and not self._is_enough(accepted):
            views = yield Query([ego.union(part) for part in parts])
            failed = []
            for part, view in zip(parts, views, strict=True):
                if self._consistency(frame, view, reference) > self.epsilon:
                    accepted |= frozenset(part)
                elif len(part) > 1:
                    failed.append(part)
                else:
                    accused |= set(part)
            parts = [half for part in failed for half in halves(part)]
        self.accused = frozenset(accused) - (accepted or {0})
        return Verdict(accepted or {0}, self.accused)

    def belief(self) -> np.ndarray:
        return np.array([float(i in self.accused) for i in range(self.n_vehicles)])

    def _is_enough(self, accepted: Group) -> bool:
        return self.n_upper is not None and len(accepted) >= self.n_upper

    def _consistency(self, frame: Frame, view: View, reference: View) -> float:
        compare = frame.agreement if self.score == "agreement" else frame.similarity
        return compare(view, reference)


def halves(members: list[int]) -> list[list[int]]:
    """The first ⌊n/2⌋ and the rest."""
    return [members[: len(members) // 2], members[len(members) // 2 :]]
