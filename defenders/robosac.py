"""ROBOSAC (Li et al., "Among Us", ICCV 2023): sample teams until one agrees with the ego-only view."""

from __future__ import annotations

import math
from collections.abc import Generator, Mapping, Sequence

import numpy as np

from defenders.checks import check_choice
from defenders.protocol import Defender, Frame, Inspection, Query, Verdict, View
from defenders.thresholds.tables import EGO_ONLY, open_thresholds

Group = frozenset[int]
Search = Generator[Query, list[View], Group]
READINGS = ("replacement", "budgeted", "until_success")
RATIOS = (0.0, 0.2, 0.4, 0.6, 0.8)
MOST_TRIES = 1000  # in a frame, where a reading sets no limit


class Robosac(Defender):
    """Random sample consensus, anew in every frame. The reference is the ego-only view, which is not counted.

    A team of s vehicles passes if its view has a Jaccard similarity of at least ε to the reference. If no team passes
    within the tries, the ego perceives alone. The readings differ in the size of a team and in the number of tries,
    which follow from the share η of attackers among the vehicles that can be drawn:

    * `replacement`: s = n - k, and the N tries (`tries_needed`) that find the benign vehicles with `confidence` if
      every try draws each vehicle anew.
    * `budgeted`: `budget` tries, and the largest team (`team_size`) they find with `confidence`, at most n - k.
    * `until_success`: s = n - k, until one passes. PRBI's Table 2 counts so.

    Teams are drawn without replacement, as its code does, so the N of its paper is more than is needed.

    Without `n_attackers` the share of attackers is probed ("aggressive to conservative probing"). Each frame goes round
    the `ratios` still open, the smallest and so the largest team first, with `budget` tries in all. A ratio is given up
    after the N failures of "replacement". A ratio that passes closes itself and all above it.

    Where paper and code are silent: The tries that probing leaves over go to teams at the ratio found. Two ratios that
    round to the same number of attackers are one. Once all are given up the ego stays alone. An absent vehicle is
    neither drawn nor flagged, and a team is cut to the present vehicles. No frame has more than 1,000 tries.
    """

    max_queries = MOST_TRIES + 2

    def __init__(
        self,
        *,
        reading: str = "replacement",
        n_attackers: int | None = None,
        budget: int = 5,
        ratios: Sequence[float] = RATIOS,
        threshold: str | Mapping[int, float] = "paper",
        epsilon: float = 0.3,
        confidence: float = 0.99,
        trust_ego: bool = True,
    ) -> None:
        """Build the defender.

        Args:
            reading: "replacement", "budgeted" or "until_success": see the class.
            n_attackers: k, where it is known. Else the share of attackers is probed.
            budget: Tries in a frame, of "budgeted" and of probing.
            ratios: Shares of attackers that are probed.
            threshold: "paper": ε for every team. "calibrated": one ε for each size of the group that is fused, measured
                with the ego's detector. Or a calibration file, or a mapping from size to ε.
            epsilon: ε, the least similarity to the ego-only view.
            confidence: Probability with which the tries are meant to find an uncontaminated team.
            trust_ego: As published: the ego is in every team and never drawn. False draws teams from all vehicles.

        Raises:
            ValueError: If an option is out of range.
        """
        check_choice("reading", reading, READINGS)
        if n_attackers is None and reading != "replacement":
            raise ValueError(
                f"reading {reading!r} needs the number of attackers; pass n_attackers= or use 'replacement'"
            )
        if n_attackers is not None and n_attackers < 0:
            raise ValueError(f"n_attackers must be at least 0, got {n_attackers}")
        if not 0 < confidence < 1:
            raise ValueError(f"confidence is a probability strictly between 0 and 1, got {confidence}")
        if not ratios or not all(0 <= ratio <= 1 for ratio in ratios):
            raise ValueError(f"ratios are one or more shares of attackers in [0, 1], got {list(ratios)}")
        least = len(ratios) if n_attackers is None else 1
        if budget < least:
            raise ValueError(f"budget must allow {least} tries a frame (one for each ratio probed), got {budget}")
        self.reading, self.n_attackers, self.budget, self.ratios = reading, n_attackers, budget, tuple(ratios)
        self.epsilon = open_thresholds(threshold, epsilon, EGO_ONLY["similarity"])
        self.confidence, self.trust_ego = confidence, trust_ego
        self._ego: Group = frozenset({0}) if trust_ego else frozenset()

    def configure(self, *, fusion: str) -> None:
        self.epsilon = self.epsilon.of(fusion)

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        """Begin an episode. ValueError for too many attackers, or a budget that finds no benign vehicle."""
        if self.n_attackers is not None and self.n_attackers >= n_vehicles:
            raise ValueError(f"n_attackers must be below the {n_vehicles} vehicles, got {self.n_attackers}")
        self.n_vehicles, self.rng = n_vehicles, rng
        self.pool = np.arange(int(self.trust_ego), n_vehicles)
        self.flagged: Group = frozenset()
        self.size, self.tries = (
            (0, 0) if self.n_attackers is None else self._plan(min(self.n_attackers, len(self.pool)))
        )
        numbers = sorted({round(ratio * len(self.pool)) for ratio in self.ratios} - {len(self.pool)})
        self.left = {k: self._tries_for(k) for k in numbers}  # tries until a number of attackers is given up
        self.found: int | None = None  # the least number of attackers at which a team passed

    def inspect(self, frame: Frame) -> Inspection:
        self.flagged = frozenset()
        self.there = np.array([i for i in self.pool.tolist() if i in frame.present], dtype=np.int64)
        team: Group = frozenset()
        if self.n_attackers is None:
            team = yield from self._probe(frame)
        else:
            if self.size:
                (reference,) = yield Query([{0}], verification=False)
                team = yield from self._sample(frame, reference, self.size, self.tries)
            if len(team - self._ego) == len(self.pool) - self.n_attackers:
                self.flagged = frozenset(self.there.tolist()) - team  # as many are left out as there are attackers
        return Verdict(team or {0}, self.flagged)

    def belief(self) -> np.ndarray:
        return np.array([float(i in self.flagged) for i in range(self.n_vehicles)])

    def _plan(self, k: int) -> tuple[int, int]:
        """Team size and most tries in a frame if k vehicles of the pool attack; (0, 0) if all of them do."""
        size = len(self.pool) - k
        if size == 0:
            return 0, 0
        if self.reading == "until_success":
            return size, MOST_TRIES
        if self.reading == "replacement":
            return size, min(self._tries_for(k), MOST_TRIES)
        eta = k / len(self.pool)
        affordable = team_size(eta, self.budget, self.confidence)
        if affordable < 1:
            raise ValueError(
                f"a budget of {self.budget} tries finds no benign vehicle among {len(self.pool)}, {k} malicious,"
                f" with confidence {self.confidence}; it takes {tries_needed(eta, 1, self.confidence)}"
            )
        return int(min(size, affordable)), self.budget

    def _tries_for(self, k: int) -> int:
        return tries_needed(k / len(self.pool), len(self.pool) - k, self.confidence)

    def _sample(self, frame: Frame, reference: View, size: int, tries: int) -> Search:
        """The first of so many random teams that passes; empty if none does."""
        for _ in range(tries):
            team = self._ego.union(self.rng.permutation(self.there)[:size].tolist())
            (view,) = yield Query([team])
            if frame.similarity(view, reference) >= self.epsilon(team):
                return team
        return frozenset()

    def _probe(self, frame: Frame) -> Search:
        """One frame of probing: the open numbers of attackers, then the rest of the budget at the number found."""
        (reference,) = yield Query([{0}], verification=False)
        team: Group = frozenset()
        budget = self.budget
        while budget and (open_ := [k for k, left in self.left.items() if left]):
            for k in open_[:budget]:
                budget -= 1
                if drawn := (yield from self._sample(frame, reference, len(self.pool) - k, 1)):
                    team, self.found = drawn, k
                    self.left = {number: left for number, left in self.left.items() if number < k}
                    break
                self.left[k] -= 1
        if not team and self.found is not None:
            team = yield from self._sample(frame, reference, len(self.pool) - self.found, budget)
        if team:
            self.flagged = frozenset(self.there.tolist()) - team
        return team


def tries_needed(eta: float, size: int, confidence: float) -> int:
    """N = ⌈ln(1-confidence) / ln(1-(1-η)^s)⌉: tries that draw a benign team of s at attacker ratio η."""
    benign = (1 - eta) ** size
    return 1 if benign == 1 else math.ceil(math.log(1 - confidence) / math.log1p(-benign))


def team_size(eta: float, budget: int, confidence: float) -> float:
    """s = ⌊ln(1-(1-confidence)^(1/budget)) / ln(1-η)⌋: largest benign team in `budget` tries; η = 0: inf."""
    if eta in (0, 1):
        return math.inf if eta == 0 else 0
    return math.floor(math.log(1 - (1 - confidence) ** (1 / budget)) / math.log(1 - eta))
