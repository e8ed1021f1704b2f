"""Every rule for defenders can fail: for each there are mutants of a lawful defender that break it before any other."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
import pytest

import defenders
from cp_env.testing import DefenderRuleBroken, check_defender
from cp_env.testing.defender import RULES
from defenders import Defender, Frame, Inspection, Query, Verdict

ALL = tuple(rule.__name__ for rule in RULES)
MUTANTS: list[tuple[str, type]] = []


class Lawful(Defender):
    """Asks for one group that it draws, and fuses it if it resembles the full view."""

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        self.n, self.rng, self.frames = n_vehicles, rng, 0

    def inspect(self, frame: Frame) -> Inspection:
        self.frames += 1
        group = frozenset(self.rng.permutation(sorted(frame.present))[: 1 + len(frame.present) // 2].tolist())
        (view,) = yield Query([group])
        return Verdict(group if frame.similarity(view, frame.seen) > 0.5 else {0})

    def belief(self) -> np.ndarray:
        return np.full(self.n, 0.5)


def breaks(rule: str) -> Callable[[type], type]:
    """Enter a mutant into the list, with the rule it breaks."""

    def enter(mutant: type) -> type:
        MUTANTS.append((rule, mutant))
        return mutant

    return enter


@breaks("derives_from_defender")
class Duck:
    max_queries = 64
    configure, reset, inspect, belief = Defender.configure, Lawful.reset, Lawful.inspect, Lawful.belief


@breaks("has_the_methods")
class TakesNoGenerator(Lawful):
    def reset(self, n_vehicles: int) -> None:  # type: ignore[override]
        super().reset(n_vehicles, np.random.default_rng(0))


@breaks("has_the_methods")
class ConfiguredByPosition(Lawful):
    def configure(self, name: str) -> None: ...  # type: ignore[override]


@breaks("has_the_methods")
class NeverAsks(Lawful):
    max_queries = 0


@breaks("inspect_is_a_generator")
class ReturnsAtOnce(Lawful):
    def inspect(self, frame: Frame) -> Any:
        return Verdict(frame.present)


@breaks("queries_and_verdicts_are_valid")
class CountsFromOne(Lawful):
    def inspect(self, frame: Frame) -> Inspection:
        yield Query([{vehicle + 1} for vehicle in frame.present])
        return Verdict(frame.present)


@breaks("queries_and_verdicts_are_valid")
class FusesNobody(Lawful):
    def inspect(self, frame: Frame) -> Inspection:
        yield Query([frame.present])
        return Verdict([])


@breaks("queries_and_verdicts_are_valid")
class AsksWithoutEnd(Lawful):
    def inspect(self, frame: Frame) -> Inspection:
        while True:
            yield Query([{0}])


@breaks("queries_and_verdicts_are_valid")
class DoesNotPay(Lawful):
    def inspect(self, frame: Frame) -> Inspection:
        yield Query([{vehicle} for vehicle in frame.present], verification=False)
        return Verdict(frame.present)


@breaks("absent_vehicles_are_endured")
class CountsOnEveryone(Lawful):
    def inspect(self, frame: Frame) -> Inspection:
        yield Query([{vehicle} for vehicle in range(frame.n_vehicles)])
        return Verdict(frame.present)


@breaks("episodes_repeat")
class DrawsElsewhere(Lawful):
    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        super().reset(n_vehicles, np.random.default_rng())


@breaks("reset_forgets")
class KeepsItsCount(Lawful):
    frames = 0

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        self.n, self.rng = n_vehicles, rng

    def inspect(self, frame: Frame) -> Inspection:
        self.frames += 1
        yield Query([{0}] * self.frames)
        return Verdict({0})


@breaks("worlds_are_apart")
class KeepsItOnTheClass(Lawful):
    seen: ClassVar[list[int]] = []

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        super().reset(n_vehicles, rng)
        self.seen.clear()

    def inspect(self, frame: Frame) -> Inspection:
        self.seen.append(frame.index)
        yield Query([{0}] * len(self.seen))
        return Verdict({0})


@breaks("it_pickles")
class HoldsALambda(Lawful):
    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        super().reset(n_vehicles, rng)
        self.compare = lambda value: value > 0.5


@breaks("it_pickles")
class LeavesItsStateBehind(Lawful):
    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "rng": np.random.default_rng(1)}


@breaks("belief_is_a_probability")
class Logits(Lawful):
    def belief(self) -> np.ndarray:
        return np.linspace(-3, 3, self.n)


@breaks("belief_is_a_probability")
class BelievesOnlyAfterAFrame(Lawful):
    def belief(self) -> np.ndarray:
        return np.full(self.n, np.nan if self.frames == 0 else 0.5)


@breaks("belief_is_a_probability")
class ForgetsTheEgo(Lawful):
    def belief(self) -> np.ndarray:
        return np.zeros(self.n - 1)


@pytest.mark.parametrize(("rule", "mutant"), MUTANTS, ids=[mutant.__name__ for _, mutant in MUTANTS])
def test_a_mutant_breaks_its_rule(rule: str, mutant: type) -> None:
    with pytest.raises(DefenderRuleBroken) as caught:
        check_defender(mutant)
    assert caught.value.rule == rule, str(caught.value)
    assert "the rule: " in str(caught.value)


def test_every_rule_has_a_mutant() -> None:
    assert {rule for rule, _ in MUTANTS} == set(ALL)


@pytest.mark.parametrize("name", defenders.names())
def test_defenders_that_ship_keep_every_rule(name: str) -> None:
    assert check_defender(lambda: defenders.make(name)) == ALL


def test_a_finished_defender_is_left_untouched() -> None:
    ready = Lawful()
    assert check_defender(ready) == check_defender(Lawful) == ALL
    assert vars(ready) == {}


def test_what_raises_is_named_with_its_place() -> None:
    class Broken(Lawful):
        def inspect(self, frame: Frame) -> Inspection:
            yield Query([frame.present])
            raise KeyError("no such vehicle")

    with pytest.raises(DefenderRuleBroken, match="the defender raised KeyError: 'no such vehicle'") as caught:
        check_defender(Broken)
    assert caught.value.__cause__ is not None
    assert traceback.extract_tb(caught.value.__cause__.__traceback__)[-1].name == "inspect"


def test_rules_can_be_skipped_by_name_only() -> None:
    kept = check_defender(Logits, skip=["belief_is_a_probability"])
    assert kept == tuple(name for name in ALL if name != "belief_is_a_probability")
    with pytest.raises(ValueError, match=r"no rules called \['pickles'\]; the rules are .*it_pickles"):
        check_defender(Lawful, skip=["pickles"])
