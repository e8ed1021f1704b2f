"""A simulated world without scenes: the similarity of a group's view depends only on the attackers in the group.

It drives any defender, thousands of episodes a second, and measures the logic of the defender alone. By default the
verifier is perfect: two views have similarity 1 if both are right, and 0 otherwise. `defenders.simulation.verifier` has
verifiers with errors. Views are bare numbers, so a defender cannot read them. `defenders.simulation.statistics` plays
many episodes at once.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, field

import numpy as np

from defenders.checks import check_paid
from defenders.protocol import Defender, Frame, Informed, Query, QueryError, Verdict
from defenders.simulation.verifier import Group, SimilarityModel, exact

Schedule = Callable[[int, Group], Group]
"""From the number of a frame (0 begins the episode) and the attackers to the attackers that are active in that frame.

As `absent`, to the vehicles that are absent in that frame."""


def always(frame: int, attackers: Group) -> Group:
    """All attackers, in every frame."""
    return attackers


def every(period: int, *, start: int = 0) -> Schedule:
    """All attackers in the frames `start`, `start + period`, …, none in between (the paper's Table 6)."""
    if period < 1 or start < 0:
        raise ValueError(f"a schedule needs period >= 1 and start >= 0, got period={period}, start={start}")
    return lambda frame, attackers: attackers if frame >= start and (frame - start) % period == 0 else frozenset()


def turning(at: int, *, late: int = 1) -> Schedule:
    """All attackers, but the `late` ones of highest number only from frame `at` on."""
    if at < 0 or late < 1:
        raise ValueError(f"a schedule needs at >= 0 and late >= 1, got at={at}, late={late}")
    return lambda frame, attackers: attackers if frame >= at else frozenset(sorted(attackers)[:-late])


def nobody(frame: int, attackers: Group) -> Group:
    """Nobody, in any frame."""
    return frozenset()


@dataclass(frozen=True, slots=True)
class FrameResult:
    """Verdict, queries and cost of a defender in one frame."""

    verdict: Verdict
    groups: tuple[Group, ...]  # every group queried, in order
    verifications: int  # groups that count as verifications
    active: Group = frozenset()  # active attackers


@dataclass(frozen=True, slots=True)
class SimulatedFrame:
    """One frame as a defender sees it (see `defenders.protocol.Frame`)."""

    index: int
    n_vehicles: int
    present: Group
    seen: int
    similarity: Callable[[int, int], float]
    agreement: Callable[[int, int], float]


@dataclass
class SimulatedWorld:
    """One episode. In frames judged with `attack=True` the attackers that the schedule names are active, if present.

    The similarity of two views is that of the later one to a right reference. If the earlier one is contaminated, it is
    at most the earlier's own. So a perturbation that shows is a reference that no view resembles, and one that does not
    show is as good as the truth. A group that is queried twice in a frame gets the same view. The agreement is half the
    similarity.
    """

    n_vehicles: int
    attackers: Group
    frame: int = 0
    views: list[float] = field(default_factory=list, repr=False)  # similarity of view number i to a right reference
    similarity_model: SimilarityModel = exact
    schedule: Schedule = always
    absent: Schedule = nobody  # absent vehicles; never the ego
    rng: np.random.Generator = field(
        default_factory=lambda: np.random.default_rng(0), repr=False
    )  # of the similarity model

    def __post_init__(self) -> None:
        self.everyone: Group = frozenset(range(self.n_vehicles))
        if not self.attackers <= self.everyone:
            raise ValueError(
                f"attackers must be among the vehicles 0..{self.n_vehicles - 1}, got {sorted(self.attackers)}"
            )
        self.present, self.active = self.everyone, frozenset[int]()  # in the current frame
        self._malicious: list[bool] = []  # whether view number i is contaminated
        self._numbers: dict[Group, int] = {}  # numbers of the current frame's views

    def view(self, group: Iterable[int]) -> int:
        """View of a group in the current frame: of its present members."""
        group = frozenset(group) & self.present
        if group not in self._numbers:
            active = group & self.active
            self._numbers[group] = len(self.views)
            self.views.append(self.similarity_model(group, active, self.rng))
            self._malicious.append(bool(active))
        return self._numbers[group]

    def similarity(self, a: int, b: int) -> float:
        earlier, later = (a, b) if a <= b else (b, a)
        value = self.views[later]
        return min(value, self.views[earlier]) if self._malicious[earlier] else value

    def agreement(self, a: int, b: int) -> float:
        return 0.5 * self.similarity(a, b)

    def show(self, attack: bool) -> Frame:
        """Show the next frame, with its full view. ValueError if the ego is absent."""
        if 0 in (absent := self.absent(self.frame, self.attackers)):
            raise ValueError(f"the ego, vehicle 0, is always present; absent in frame {self.frame}: {sorted(absent)}")
        self.present = self.everyone - absent
        self.active = self.schedule(self.frame, self.attackers) & self.present if attack else frozenset()
        self._numbers = {}
        self.frame += 1
        seen = self.view(self.everyone)
        return SimulatedFrame(self.frame - 1, self.n_vehicles, self.present, seen, self.similarity, self.agreement)

    def judge(self, defender: Defender, attack: bool = True) -> FrameResult:
        """Show a defender the next frame, answer its queries, and count them.

        Args:
            defender: The defender.
            attack: Whether the attackers that the schedule names are active.

        Returns:
            The verdict, the queries and their cost.

        Raises:
            QueryError: If a query or the verdict is invalid.
        """
        groups: list[Group] = []
        uncounted: list[Group] = []
        queries = 0
        inspection = defender.inspect(self.show(attack))
        try:
            query = next(inspection)
            while True:
                queries += 1
                self._check(query, queries, defender.max_queries)
                groups += query.groups
                uncounted += () if query.verification else query.groups
                query = inspection.send([self.view(group) for group in query.groups])
        except StopIteration as stop:
            verdict = self._checked(stop.value)
            self._check_paid(groups, uncounted, verdict)
            return FrameResult(verdict, tuple(groups), len(groups) - len(uncounted), self.active)
        finally:
            inspection.close()

    def _check_paid(self, groups: list[Group], uncounted: list[Group], verdict: Verdict) -> None:
        """QueryError if more was shown without paying than is free: see `defenders.checks.check_paid`."""
        counted = Counter(groups) - Counter(uncounted)
        try:
            check_paid(
                [group & self.present for group in uncounted],
                [group & self.present for group in counted],
                verdict.collaborators & self.present,
                self.present,
            )
        except ValueError as error:
            raise QueryError(str(error)) from error

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
                f"a verdict must fuse one or more of {self.n_vehicles} vehicles and flag none but them, got "
                f"{sorted(verdict.collaborators)} and {sorted(verdict.suspects)}; present in this frame are "
                f"{sorted(self.present)}"
            )
        return verdict


@dataclass(frozen=True, slots=True)
class Episode:
    """The recorded frames of an episode: those after the grace frames."""

    attackers: Group
    results: tuple[FrameResult, ...]

    @property
    def converged(self) -> bool:
        return self.results[-1].verdict.converged

    @property
    def suspects(self) -> Group:
        return self.results[-1].verdict.suspects

    @property
    def verifications(self) -> list[int]:
        return [result.verifications for result in self.results]


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """Conditions of an episode: who may attack, when, and how informative a verification is.

    Attributes:
        n_vehicles: Maps that can be fused. Vehicle 0 is the ego.
        n_attackers: Number of attackers, drawn at random.
        benign: Vehicles that are never drawn. {0} is a trusted ego.
        similarity_model: Similarity of a group's view to a right reference: see `defenders.simulation.verifier`.
        schedule: Attackers that are active in a frame.
        absent: Vehicles that are absent in a frame.
        grace_frames: Frames without an attack at the start. They are not recorded, but the schedule counts them.
        max_frames: Frames that are recorded, at most.
        until_converged: Whether an episode ends with the frame in which the defender has converged.

    Raises:
        ValueError: If the conditions are contradictory.
    """

    n_vehicles: int
    n_attackers: int
    benign: Collection[int] = ()
    similarity_model: SimilarityModel = exact
    schedule: Schedule = always
    absent: Schedule = nobody
    grace_frames: int = 1
    max_frames: int = 100
    until_converged: bool = True

    def __post_init__(self) -> None:
        able = self.n_vehicles - len(set(self.benign))
        if not set(self.benign) <= set(range(self.n_vehicles)):
            raise ValueError(f"benign must name vehicles 0..{self.n_vehicles - 1}, got {sorted(self.benign)}")
        if not 0 <= self.n_attackers <= min(able, self.n_vehicles - 1):
            raise ValueError(
                f"n_attackers must leave one vehicle benign: {self.n_attackers} of the {able} that may attack, "
                f"n_vehicles = {self.n_vehicles}"
            )
        if self.max_frames < 1 or self.grace_frames < 0:
            raise ValueError(
                f"max_frames must be at least 1 and grace_frames at least 0, got {self.max_frames} and "
                f"{self.grace_frames}"
            )

    def play(self, defender: Defender, seed: int | np.random.SeedSequence) -> Episode:
        """Play one episode. The same seed draws the same attackers for every defender."""
        sequence = seed if isinstance(seed, np.random.SeedSequence) else np.random.SeedSequence(seed)
        world_rng, defender_rng = (np.random.default_rng(child) for child in sequence.spawn(2))
        able = [i for i in range(self.n_vehicles) if i not in self.benign]
        attackers = frozenset(world_rng.permutation(able)[: self.n_attackers].tolist())
        world = SimulatedWorld(
            self.n_vehicles,
            attackers,
            similarity_model=self.similarity_model,
            schedule=self.schedule,
            absent=self.absent,
            rng=world_rng,
        )
        if isinstance(defender, Informed):
            defender.reveal_attackers(attackers)
        defender.reset(self.n_vehicles, defender_rng)
        for _ in range(self.grace_frames):
            world.judge(defender, attack=False)
        results = [world.judge(defender)]
        while len(results) < self.max_frames and not (self.until_converged and results[-1].verdict.converged):
            results.append(world.judge(defender))
        return Episode(attackers, tuple(results))


def play(defender: Defender, n_vehicles: int, n_attackers: int, seed: int, max_frames: int = 100) -> Episode:
    """Play one episode: frame 0 without an attack, then `n_attackers` random attackers up to convergence."""
    return Scenario(n_vehicles=n_vehicles, n_attackers=n_attackers, max_frames=max_frames).play(defender, seed)
