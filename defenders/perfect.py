"""A world without scenes: the view of a group is wrong if and only if somebody in it lies.

It drives any defender by hand, thousands of episodes a second, and measures the defender's logic alone. Two views are
alike (similarity 1) when both are right and have nothing in common (0) otherwise. Views are bare numbers, so a
defender cannot look into them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

from defenders.protocol import Defender, Frame, Query, QueryError, Verdict

Group = frozenset[int]


@dataclass(frozen=True, slots=True)
class Ruling:
    """What a defender did in one frame."""

    verdict: Verdict
    groups: tuple[Group, ...]  # every group asked, in order
    verifications: int  # those of them that count


@dataclass(frozen=True, slots=True)
class PerfectFrame:
    """One frame as a defender sees it (see `defenders.protocol.Frame`)."""

    index: int
    n_vehicles: int
    seen: int
    similarity: Callable[[int, int], float]
    agreement: Callable[[int, int], float]


@dataclass
class PerfectWorld:
    """One episode. `liars` lie in the frames judged with `lying=True`, all of them, and every lie shows."""

    n_vehicles: int
    liars: Group
    frame: int = 0
    views: list[bool] = field(default_factory=list, repr=False)  # whether view number i is right

    def look(self, group: Iterable[int], lying: bool) -> int:
        """A new view of a group."""
        self.views.append(not lying or self.liars.isdisjoint(group))
        return len(self.views) - 1

    def similarity(self, a: int, b: int) -> float:
        return float(self.views[a] and self.views[b])

    def agreement(self, a: int, b: int) -> float:
        return 0.5 * self.similarity(a, b)

    def show(self, lying: bool) -> Frame:
        """The next frame, everyone fused."""
        self.frame += 1
        seen = self.look(range(self.n_vehicles), lying)
        return PerfectFrame(self.frame - 1, self.n_vehicles, seen, self.similarity, self.agreement)

    def judge(self, defender: Defender, lying: bool = True) -> Ruling:
        """Show the defender the next frame, answer what it asks, and count. QueryError if it asks for nonsense."""
        asked: list[Query] = []
        inspection = defender.inspect(self.show(lying))
        try:
            query = next(inspection)
            while True:
                asked.append(self._checked(query, len(asked), defender.max_queries))
                query = inspection.send([self.look(group, lying) for group in query.groups])
        except StopIteration as stop:
            groups = tuple(group for query in asked for group in query.groups)
            return Ruling(stop.value, groups, sum(len(query.groups) for query in asked if query.verification))
        finally:
            inspection.close()

    def _checked(self, query: Query, count: int, most: int) -> Query:
        if count >= most:
            raise QueryError(f"more than max_queries = {most} queries in one frame")
        for group in query.groups:
            if not group or not group <= frozenset(range(self.n_vehicles)):
                raise QueryError(f"a group must hold one or more of {self.n_vehicles} vehicles, got {sorted(group)}")
        return query


@dataclass(frozen=True, slots=True)
class Episode:
    """From the first abnormal frame to convergence, both counted."""

    liars: Group
    rulings: tuple[Ruling, ...]

    @property
    def converged(self) -> bool:
        return self.rulings[-1].verdict.converged

    @property
    def suspects(self) -> Group:
        return self.rulings[-1].verdict.suspects

    @property
    def verifications(self) -> list[int]:
        return [ruling.verifications for ruling in self.rulings]


def play(defender: Defender, n_vehicles: int, n_liars: int, seed: int, max_frames: int = 100) -> Episode:
    """Frame 0 is honest; from then on `n_liars` vehicles drawn at random lie, until the defender has converged."""
    draw, mind = (np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(2))
    world = PerfectWorld(n_vehicles, frozenset(draw.permutation(n_vehicles)[:n_liars].tolist()))
    if (tell := getattr(defender, "tell", None)) is not None:
        tell(world.liars)
    defender.reset(n_vehicles, mind)
    world.judge(defender, lying=False)
    rulings = [world.judge(defender)]
    while not rulings[-1].verdict.converged and len(rulings) < max_frames:
        rulings.append(world.judge(defender))
    return Episode(world.liars, tuple(rulings))
