"""ROBOSAC (ICCV 2023): sample a team until one agrees with what the ego sees alone."""

from __future__ import annotations

import math

import numpy as np

from defenders.protocol import Defender, Frame, Inspection, Query, Verdict
from defenders.readings import check_choice

READINGS = ("replacement", "budgeted", "until_success")
MOST_TRIES = 1000  # in a frame, where a reading sets no limit


class Robosac(Defender):
    """Random sample consensus, anew in every frame; the ego's own view is the reference and not counted.

    A team of s vehicles passes if its view has a Jaccard similarity of at least ε to the reference. If no team passes
    within the tries, the ego perceives alone. The readings differ in the size of a team and the number of tries, from
    the share η of liars among those who can be drawn:

        replacement    everyone but the liars, s = n - k, and the N tries that find them with `confidence` when teams
                       are drawn independently
        budgeted       `budget` tries, and the largest team that they find with `confidence`, at most n - k
        until_success  s = n - k, until one passes: how PRBI's Table 2 counts

    Without `n_attackers` the number of liars is probed, from none upwards: a number is given up after as many failures
    as "replacement" would try, at most `budget` of them a frame, and the first that passes is kept.
    """

    max_queries = MOST_TRIES + 2

    def __init__(
        self,
        *,
        reading: str = "replacement",
        n_attackers: int | None = None,
        budget: int = 5,
        epsilon: float = 0.3,
        confidence: float = 0.99,
        trust_ego: bool = True,
    ) -> None:
        """`trust_ego` as published: the ego is in every team and never drawn. False draws teams from all vehicles."""
        check_choice("reading", reading, READINGS)
        if n_attackers is None and reading != "replacement":
            raise ValueError(f"reading {reading!r} needs to know how many lie; pass n_attackers= or use 'replacement'")
        if (n_attackers is not None and n_attackers < 0) or budget < 1 or not 0 < confidence < 1:
            raise ValueError(
                "n_attackers must be at least 0, budget at least 1 and confidence between 0 and 1; got "
                f"{n_attackers}, {budget} and {confidence}"
            )
        self.reading, self.n_attackers, self.budget = reading, n_attackers, budget
        self.epsilon, self.confidence, self.trust_ego = epsilon, confidence, trust_ego

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        """ValueError if nobody would be left to draw."""
        self.pool = list(range(int(self.trust_ego), n_vehicles))
        if self.n_attackers is not None and self.n_attackers >= n_vehicles:
            raise ValueError(f"n_attackers must be below the {n_vehicles} vehicles, got {self.n_attackers}")
        self.n_vehicles, self.rng = n_vehicles, rng
        self.probed, self.failures, self.kept = 0, 0, False
        self.accused: frozenset[int] = frozenset()

    def inspect(self, frame: Frame) -> Inspection:
        size, tries = self._plan()
        ego = {0} if self.trust_ego else set()
        self.accused = frozenset()
        team: set[int] = set()
        if size > 0:
            (reference,) = yield Query([{0}], verification=False)
            for _ in range(tries):
                drawn = ego | set(self.rng.permutation(self.pool)[:size].tolist())
                (view,) = yield Query([drawn])
                if frame.similarity(view, reference) >= self.epsilon:
                    team = drawn
                    break
        if team and size == len(self.pool) - self._liars():
            self.accused = frozenset(self.pool) - team  # as many are left out as are taken to lie
        self._learn(bool(team), tries)
        return Verdict(team or {0}, self.accused)

    def belief(self) -> np.ndarray:
        return np.array([float(i in self.accused) for i in range(self.n_vehicles)])

    def _liars(self) -> int:
        """How many of those who can be drawn are taken to lie."""
        return min(self.probed if self.n_attackers is None else self.n_attackers, len(self.pool))

    def _plan(self) -> tuple[int, int]:
        """Size of a team and number of tries in this frame; no try where everyone is taken to lie."""
        size, eta = len(self.pool) - self._liars(), self._liars() / len(self.pool)
        if size == 0:
            return 0, 0
        if self.reading == "until_success":
            return size, MOST_TRIES
        if self.reading == "budgeted":
            return int(min(size, team_size(eta, self.budget, self.confidence))), self.budget
        tries = tries_needed(eta, size, self.confidence)
        return size, tries if self.n_attackers is not None else min(tries - self.failures, self.budget)

    def _learn(self, passed: bool, tries: int) -> None:
        """Probing: a number of liars is kept once a team passed, and given up when its tries are used up before."""
        if self.n_attackers is not None:
            return
        self.kept = self.kept or passed
        self.failures = 0 if self.kept else self.failures + tries
        size = len(self.pool) - self._liars()
        if size and self.failures >= tries_needed(self._liars() / len(self.pool), size, self.confidence):
            self.probed, self.failures = self.probed + 1, 0


def tries_needed(eta: float, size: int, confidence: float) -> int:
    """N: tries after which a clean team of `size` was drawn with `confidence`, a share `eta` of liars given."""
    clean = (1 - eta) ** size
    return 1 if clean == 1 else math.ceil(math.log(1 - confidence) / math.log(1 - clean))


def team_size(eta: float, budget: int, confidence: float) -> float:
    """s: the largest team of which `budget` tries find a clean one with `confidence`; unbounded if nobody lies."""
    if eta in (0, 1):
        return math.inf if eta == 0 else 0
    return math.floor(math.log(1 - (1 - confidence) ** (1 / budget)) / math.log(1 - eta))
