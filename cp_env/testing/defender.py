"""Conformance rules for defenders: one for each promise of `defenders.Defender`.

    from cp_env.testing import check_defender
    check_defender(MyDefender)

A defender is checked through its methods alone, in the simulated world: it needs no scenes and no detector. How well it
defends is no rule.
"""

from __future__ import annotations

import copy
import inspect
import pickle
from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from cp_env.testing.attack import chosen
from cp_env.testing.rollout import Violation, require
from defenders.protocol import Defender, Informed, QueryError
from defenders.simulation.verifier import ErrorRates
from defenders.simulation.world import FrameResult, Schedule, SimulatedWorld, nobody

FRAMES = 6
"""Frames that a rule plays; the first is without an attack."""

FLEETS = ((2, (1,)), (5, ()), (5, (0, 3)), (6, (1, 2, 3, 4, 5)))
"""(n_vehicles, attackers): few and many, none of them malicious, the ego among them, all but the ego."""


@dataclass(eq=False)
class Trial:
    """A defender and what it is tried on."""

    make: Callable[[], Any]

    def begin(self, defender: Any, n: int = 5, attackers: tuple[int, ...] = (1, 3), seed: int = 0) -> None:
        """Reset a defender for an episode, as the referee does."""
        if isinstance(defender, Informed):
            defender.reveal_attackers(frozenset(attackers))
        defender.reset(n, np.random.default_rng([3, seed]))

    def fresh(self, **episode: Any) -> Any:
        """A new defender, configured and reset."""
        defender = self.make()
        defender.configure(fusion="mean")
        self.begin(defender, **episode)
        return defender

    def play(self, defender: Any, world: SimulatedWorld, frames: int = FRAMES) -> list[FrameResult]:
        """Judge the next frames of a world; the first of an episode is without an attack."""
        return [world.judge(defender, attack=world.frame > 0) for _ in range(frames)]

    @cached_property
    def results(self) -> list[FrameResult]:
        """What a fresh defender does."""
        return self.play(self.fresh(), world())


def world(n: int = 5, attackers: tuple[int, ...] = (1, 3), seed: int = 0, absent: Schedule = nobody) -> SimulatedWorld:
    """A simulated episode, whose verifier errs now and then."""
    erring = ErrorRates(0.1, 0.1)
    rng = np.random.default_rng([5, seed])
    return SimulatedWorld(n, frozenset(attackers), similarity_model=erring, absent=absent, rng=rng)


DefenderRule = Callable[[Trial], None]


def derives_from_defender(trial: Trial) -> None:
    """It derives from `defenders.Defender`: by this class a defender is known wherever one is named."""
    require(
        isinstance(trial.make(), Defender), f"{type(trial.make()).__name__} does not derive from defenders.Defender"
    )


def has_the_methods(trial: Trial) -> None:
    """It takes `configure(fusion=…)`, `reset(n_vehicles, rng)` and `inspect(frame)`, and `max_queries` is a number."""
    defender = trial.make()
    for name, given, options in (
        ("configure", (), {"fusion": "mean"}),
        ("reset", (5, None), {}),
        ("inspect", (None,), {}),
    ):
        try:
            inspect.signature(getattr(defender, name)).bind(*given, **options)
        except TypeError as error:
            require(False, f"{name} cannot be called as the referee calls it: {error}")
    most = defender.max_queries
    require(isinstance(most, int) and most >= 1, f"max_queries must be a whole number of at least 1, not {most!r}")


def inspect_is_a_generator(trial: Trial) -> None:
    """`inspect` is a generator: it has a `yield`, even if it never asks; then write `if False: yield`."""
    made = trial.fresh().inspect(world().show(attack=False))
    require(inspect.isgenerator(made), f"inspect gave a {type(made).__name__}, no generator")
    made.close()


def queries_and_verdicts_are_valid(trial: Trial) -> None:
    """In any fleet it asks for vehicles that exist, not without end, pays for views, and returns a Verdict."""
    for n, attackers in FLEETS:
        with _as_violation(f"{n} vehicles, attackers {attackers}"):
            trial.play(trial.fresh(n=n, attackers=attackers), world(n, attackers))


def absent_vehicles_are_endured(trial: Trial) -> None:
    """Vehicles appear and drop out: each group, and the verdict, holds a vehicle that is present."""

    def dropped(frame: int, attackers: frozenset[int]) -> frozenset[int]:
        return frozenset() if frame == 0 else frozenset({1, 2, 3, 4} - {frame % 5})

    with _as_violation("all but one or two vehicles are absent"):
        trial.play(trial.fresh(), world(absent=dropped))


def episodes_repeat(trial: Trial) -> None:
    """The same generator gives the same queries and verdicts: all randomness comes from `rng`."""
    _same(trial.results, trial.play(trial.fresh(), world()), "from the same generator")


def reset_forgets(trial: Trial) -> None:
    """`reset` begins anew: nothing of the last episode, nor of its fleet, shows in the next."""
    defender = trial.fresh(n=6, attackers=(2,), seed=1)
    trial.play(defender, world(6, (2,), seed=1))
    trial.begin(defender)
    _same(trial.results, trial.play(defender, world()), "after another episode")


def worlds_are_apart(trial: Trial) -> None:
    """Two defenders that play by turns do not disturb each other: nothing is kept on the class or in the module."""
    mine, other = trial.fresh(), trial.fresh(n=6, attackers=(2,), seed=1)
    here, there = world(), world(6, (2,), seed=1)
    results = []
    for _ in range(FRAMES):
        trial.play(other, there, 1)
        results += trial.play(mine, here, 1)
    _same(trial.results, results, "beside another world's")


def it_pickles(trial: Trial) -> None:
    """It pickles between frames and goes on as if nothing had happened: environments are copied and sent."""
    defender, here = trial.fresh(), world()
    first = trial.play(defender, here, FRAMES // 2)
    try:
        twin = pickle.loads(pickle.dumps(defender))
    except Exception as error:
        raise Violation(f"pickling raised {type(error).__name__}: {error}") from error
    _same(trial.results, first + trial.play(twin, here, FRAMES - FRAMES // 2), "after pickling")


def belief_is_a_probability(trial: Trial) -> None:
    """`belief()` is empty or a probability for each vehicle, before the first frame and after every one."""
    defender, here = trial.fresh(), world()
    for frame in range(FRAMES):
        belief = np.asarray(defender.belief(), dtype=float)
        require(belief.shape in ((0,), (5,)), f"belief has shape {belief.shape} for 5 vehicles, before frame {frame}")
        right = np.isfinite(belief).all() and ((belief >= 0) & (belief <= 1)).all()
        require(bool(right), f"belief is no probability before frame {frame}: {belief.tolist()}")
        trial.play(defender, here, 1)


class _as_violation:
    """A query or verdict that the referee refuses, as a broken rule."""

    def __init__(self, where: str) -> None:
        self.where = where

    def __enter__(self) -> None: ...

    def __exit__(self, kind: Any, error: BaseException | None, trace: Any) -> None:
        if isinstance(error, QueryError):
            raise Violation(f"{self.where}: {error}") from None


def _same(expected: list[FrameResult], got: list[FrameResult], when: str) -> None:
    for frame, (a, b) in enumerate(zip(expected, got, strict=True)):
        require(a.groups == b.groups, f"frame {frame}: other groups are queried {when}")
        require(a.verdict == b.verdict, f"frame {frame}: another verdict {when}")


RULES: tuple[DefenderRule, ...] = (
    derives_from_defender,
    has_the_methods,
    inspect_is_a_generator,
    queries_and_verdicts_are_valid,
    absent_vehicles_are_endured,
    episodes_repeat,
    reset_forgets,
    worlds_are_apart,
    it_pickles,
    belief_is_a_probability,
)


class DefenderRuleBroken(AssertionError):
    """A defender does not keep a rule; `rule` is its name."""

    def __init__(self, rule: DefenderRule, what: str) -> None:
        self.rule = rule.__name__
        super().__init__(f"{self.rule}: {what}\n  the rule: {rule.__doc__}")


def check_defender(defender: Any, *, skip: Collection[str] = ()) -> tuple[str, ...]:
    """Check a defender against every rule.

    Args:
        defender: a defender, of which deep copies are played and which is left untouched, or what makes a new one each
            time: its class, or a function.
        skip: names of rules that do not apply.

    Returns:
        The names of the rules that were checked, all of them kept.

    Raises:
        DefenderRuleBroken: an `AssertionError` that names the first rule broken and says what happened; where the
            defender raised, its exception is the cause, with file and line.
        ValueError: an unknown name in `skip`.
    """
    rules = chosen(RULES, skip)
    ready = not inspect.isclass(defender) and hasattr(defender, "inspect")
    make: Callable[[], Any] = (lambda: copy.deepcopy(defender)) if ready or not callable(defender) else defender
    trial = Trial(make)
    for rule in rules:
        try:
            rule(trial)
        except Violation as violation:
            raise DefenderRuleBroken(rule, str(violation)) from None
        except Exception as error:
            raise DefenderRuleBroken(rule, f"the defender raised {type(error).__name__}: {error}") from error
    return tuple(rule.__name__ for rule in rules)
