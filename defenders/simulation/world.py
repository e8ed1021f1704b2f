"""A world without scenes: how right the view of a group is depends on the liars in it, and on nothing else.

It drives any defender by hand, thousands of episodes a second, and measures the defender's logic alone. By default the
verifier is perfect: two views are alike (similarity 1) when both are right and have nothing in common (0) otherwise;
`defenders.simulation.verifier` has verifiers that err. Views are bare numbers, so a defender cannot look into them.
Many episodes at once: `defenders.simulation.statistics`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, field

import numpy as np

from defenders.protocol import Defender, Frame, Query, QueryError, Verdict
from defenders.simulation.verifier import Group, Likeness, exact

Schedule = Callable[[int, Group], Group]
"""From the number of a frame (0 begins the episode) and the liars to those of them who lie in that frame.

Or, as `absent`, to the vehicles whose maps are not there in that frame."""


def always(frame: int, liars: Group) -> Group:
    """All of them, in every frame."""
    return liars


def every(period: int, *, start: int = 0) -> Schedule:
    """All of them in the frames `start`, `start + period`, …, nobody in between (the paper's Table 6)."""
    if period < 1 or start < 0:
        raise ValueError(f"a schedule needs period >= 1 and start >= 0, got period={period}, start={start}")
    return lambda frame, liars: liars if frame >= start and (frame - start) % period == 0 else frozenset()


def turning(at: int, *, late: int = 1) -> Schedule:
    """The `late` liars of highest number are honest before frame `at`; the others lie from the beginning."""
    if at < 0 or late < 1:
        raise ValueError(f"a schedule needs at >= 0 and late >= 1, got at={at}, late={late}")
    return lambda frame, liars: liars if frame >= at else frozenset(sorted(liars)[:-late])


def nobody(frame: int, liars: Group) -> Group:
    """Nobody, in any frame."""
    return frozenset()


@dataclass(frozen=True, slots=True)
class Ruling:
    """What a defender did in one frame."""

    verdict: Verdict
    groups: tuple[Group, ...]  # every group asked, in order
    verifications: int  # those of them that count
    lying: Group = frozenset()  # who lied in this frame


@dataclass(frozen=True, slots=True)
class PerfectFrame:
    """One frame as a defender sees it (see `defenders.protocol.Frame`)."""

    index: int
    n_vehicles: int
    present: Group
    seen: int
    similarity: Callable[[int, int], float]
    agreement: Callable[[int, int], float]


@dataclass
class PerfectWorld:
    """One episode. In the frames judged with `lying=True` those of `liars` lie whom the schedule names, if present.

    The similarity of two views is what `likeness` gave for the later one, unless the earlier is a lie: then it is no
    more than the earlier's own. So a lie that shows is a reference that nothing agrees with, and one that passes is as
    good as the truth. A group asked twice in a frame is looked at once. The agreement is half the similarity.
    """

    n_vehicles: int
    liars: Group
    frame: int = 0
    views: list[float] = field(default_factory=list, repr=False)  # likeness of view number i to a right reference
    likeness: Likeness = exact
    schedule: Schedule = always
    absent: Schedule = nobody  # whose maps are not there; never the ego's
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0), repr=False)  # of the likeness

    def __post_init__(self) -> None:
        self.everyone: Group = frozenset(range(self.n_vehicles))
        if not self.liars <= self.everyone:
            raise ValueError(f"liars must be among the vehicles 0..{self.n_vehicles - 1}, got {sorted(self.liars)}")
        self.present, self.lying = self.everyone, frozenset[int]()  # in the current frame
        self._lies: list[bool] = []  # whether a liar is in view number i
        self._looked: dict[Group, int] = {}  # views of the current frame

    def look(self, group: Iterable[int]) -> int:
        """The view of a group in the current frame: of those of it who are present."""
        group = frozenset(group) & self.present
        if group not in self._looked:
            lying = group & self.lying
            self._looked[group] = len(self.views)
            self.views.append(self.likeness(group, lying, self.rng))
            self._lies.append(bool(lying))
        return self._looked[group]

    def similarity(self, a: int, b: int) -> float:
        earlier, later = (a, b) if a <= b else (b, a)
        value = self.views[later]
        return min(value, self.views[earlier]) if self._lies[earlier] else value

    def agreement(self, a: int, b: int) -> float:
        return 0.5 * self.similarity(a, b)

    def show(self, lying: bool) -> Frame:
        """The next frame, everyone fused who is present. ValueError if the ego is not."""
        if 0 in (absent := self.absent(self.frame, self.liars)):
            raise ValueError(f"the ego, vehicle 0, is always present; absent in frame {self.frame}: {sorted(absent)}")
        self.present = self.everyone - absent
        self.lying = self.schedule(self.frame, self.liars) & self.present if lying else frozenset()
        self._looked = {}
        self.frame += 1
        seen = self.look(self.everyone)
        return PerfectFrame(self.frame - 1, self.n_vehicles, self.present, seen, self.similarity, self.agreement)

    def judge(self, defender: Defender, lying: bool = True) -> Ruling:
        """Show the defender the next frame, answer what it asks, and count.

        Raises QueryError if it asks for nonsense, or its verdict is none.
        """
        groups: list[Group] = []
        queries = verifications = 0
        inspection = defender.inspect(self.show(lying))
        try:
            query = next(inspection)
            while True:
                queries += 1
                self._check(query, queries, defender.max_queries)
                groups += query.groups
                verifications += len(query.groups) if query.verification else 0
                query = inspection.send([self.look(group) for group in query.groups])
        except StopIteration as stop:
            return Ruling(self._checked(stop.value), tuple(groups), verifications, self.lying)
        finally:
            inspection.close()

    def _check(self, query: object, queries: int, most: int) -> None:
        if not isinstance(query, Query):
            raise QueryError(f"inspect() must yield a Query, got {type(query).__name__}")
        if queries > most:
            raise QueryError(f"more than max_queries = {most} queries in one frame")
        for group in query.groups:
            if group.isdisjoint(self.present) or not group <= self.everyone:
                raise QueryError(
                    f"a group must hold one or more of {self.n_vehicles} vehicles, got {sorted(group)}; present in "
                    f"this frame are {sorted(self.present)}"
                )

    def _checked(self, verdict: object) -> Verdict:
        if not isinstance(verdict, Verdict):
            raise QueryError(f"inspect() must return a Verdict, got {type(verdict).__name__}")
        named = verdict.collaborators | verdict.suspects
        if not verdict.collaborators & self.present or not named <= self.everyone:
            raise QueryError(
                f"a verdict must fuse one or more of {self.n_vehicles} vehicles and accuse none but them, got "
                f"{sorted(verdict.collaborators)} and {sorted(verdict.suspects)}; present in this frame are "
                f"{sorted(self.present)}"
            )
        return verdict


@dataclass(frozen=True, slots=True)
class Episode:
    """The frames after the honest ones it began with, up to convergence; all of them counted."""

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


@dataclass(frozen=True, kw_only=True)
class Terms:
    """The terms of an episode: who may lie, when, and what a look tells. ValueError for terms that cannot be played.

    n_vehicles       maps that can be fused; vehicle 0 is the ego
    n_liars          so many vehicles, drawn at random, lie
    honest           vehicles that are never drawn: {0} is a trusted ego
    likeness         what the view of a group resembles: see `defenders.simulation.verifier`
    schedule         who of the liars lies in which frame
    absent           who is not there in which frame: has yet to appear, or has dropped out
    grace_frames     so many honest frames come first and are not recorded; the schedule counts them
    max_frames       at most so many are recorded
    until_converged  whether an episode ends with the frame in which the defender says that it has converged
    """

    n_vehicles: int
    n_liars: int
    honest: Collection[int] = ()
    likeness: Likeness = exact
    schedule: Schedule = always
    absent: Schedule = nobody
    grace_frames: int = 1
    max_frames: int = 100
    until_converged: bool = True

    def __post_init__(self) -> None:
        able = self.n_vehicles - len(set(self.honest))
        if not set(self.honest) <= set(range(self.n_vehicles)):
            raise ValueError(f"honest must name vehicles 0..{self.n_vehicles - 1}, got {sorted(self.honest)}")
        if not 0 <= self.n_liars <= min(able, self.n_vehicles - 1):
            raise ValueError(
                f"n_liars must leave one vehicle honest: {self.n_liars} of the {able} that may lie, "
                f"n_vehicles = {self.n_vehicles}"
            )
        if self.max_frames < 1 or self.grace_frames < 0:
            raise ValueError(
                f"max_frames must be at least 1 and grace_frames at least 0, got {self.max_frames} and "
                f"{self.grace_frames}"
            )

    def play(self, defender: Defender, seed: int | np.random.SeedSequence) -> Episode:
        """Play one episode; the same seed draws the same liars for every defender."""
        sequence = seed if isinstance(seed, np.random.SeedSequence) else np.random.SeedSequence(seed)
        world_rng, mind = (np.random.default_rng(child) for child in sequence.spawn(2))
        able = [i for i in range(self.n_vehicles) if i not in self.honest]
        liars = frozenset(world_rng.permutation(able)[: self.n_liars].tolist())
        world = PerfectWorld(
            self.n_vehicles,
            liars,
            likeness=self.likeness,
            schedule=self.schedule,
            absent=self.absent,
            rng=world_rng,
        )
        if (tell := getattr(defender, "tell", None)) is not None:
            tell(liars)
        defender.reset(self.n_vehicles, mind)
        for _ in range(self.grace_frames):
            world.judge(defender, lying=False)
        rulings = [world.judge(defender)]
        while len(rulings) < self.max_frames and not (self.until_converged and rulings[-1].verdict.converged):
            rulings.append(world.judge(defender))
        return Episode(liars, tuple(rulings))


def play(defender: Defender, n_vehicles: int, n_liars: int, seed: int, max_frames: int = 100) -> Episode:
    """Frame 0 is honest; from then on `n_liars` vehicles drawn at random lie, until the defender has converged."""
    return Terms(n_vehicles=n_vehicles, n_liars=n_liars, max_frames=max_frames).play(defender, seed)
