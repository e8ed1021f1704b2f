"""Every rule for attacks can fail: for each there are mutants of a lawful attack that break it before any other."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

import agents
from cp_env.perturbation.channel import project
from cp_env.testing import AttackRuleBroken, check_attack
from cp_env.testing.attack import FRAMES, RULES, Driving
from cp_env.world.scene_cache import SceneBank
from tests.helpers import situations

ALL = tuple(rule.__name__ for rule in RULES)
MUTANTS: list[tuple[str, type[agents.Attack]]] = []


@pytest.fixture(scope="module")
def bank(tmp_path_factory: pytest.TempPathFactory) -> SceneBank:
    """The crossing under a small detector."""
    return SceneBank(Driving(FRAMES), situations.Detector(channels=4).freeze(), tmp_path_factory.mktemp("bank"), False)


class Lawful(agents.Attack):
    """Noise of half the budget, the newcomer's six lines."""

    rngs: list[np.random.Generator]

    def act(self, situation: Any) -> Tensor:
        shape = situation.delta_shape[1:]
        draws = np.stack([rng.uniform(-1, 1, shape) for rng in self.rngs])
        return self.sent(situation, torch.tensor(draws, dtype=torch.float32, device=situation.device))

    def sent(self, situation: Any, draws: Tensor) -> Tensor:
        return project(draws, situation.budget / 2, situation.norm)


def breaks(rule: str) -> Callable[[type[agents.Attack]], type[agents.Attack]]:
    """Enter a mutant into the list, with the rule it breaks."""

    def enter(mutant: type[agents.Attack]) -> type[agents.Attack]:
        MUTANTS.append((rule, mutant))
        return mutant

    return enter


@breaks("has_the_methods")
class TakesNoGenerators(Lawful):
    def reset(self, n_worlds: int) -> None:  # type: ignore[override]
        self.rngs = [np.random.default_rng(0)] * n_worlds


@breaks("has_the_methods")
class DoesNotAct(Lawful):
    act = None  # type: ignore[assignment]


@breaks("generators_are_a_list")
class TakesOneGenerator(Lawful):
    """What ran in the tutorial and in no arena."""

    def reset(self, n_worlds: int, rng: Any) -> None:
        self.rngs = [rng] * n_worlds
        rng.random()


@breaks("delta_fits")
class OneAttackerOnly(Lawful):
    def sent(self, situation: Any, draws: Tensor) -> Tensor:
        return super().sent(situation, draws)[:, :1]


@breaks("delta_fits")
class GivesAnArray(Lawful):
    def sent(self, situation: Any, draws: Tensor) -> Any:
        return super().sent(situation, draws).numpy()


@breaks("delta_fits")
class KeepsTheGraph(Lawful):
    def sent(self, situation: Any, draws: Tensor) -> Tensor:
        return super().sent(situation, draws.requires_grad_())


@breaks("delta_fits")
class DividesByNothing(Lawful):
    def sent(self, situation: Any, draws: Tensor) -> Tensor:
        return super().sent(situation, draws) / 0 * 0


@breaks("budget_is_kept")
class DoubleTheBudget(Lawful):
    def sent(self, situation: Any, draws: Tensor) -> Tensor:
        return 4 * super().sent(situation, draws)


@breaks("norm_is_kept")
class ForLinfAlone(Lawful):
    def sent(self, situation: Any, draws: Tensor) -> Tensor:
        return draws * situation.budget


@breaks("something_is_sent")
class Silent(Lawful):
    def sent(self, situation: Any, draws: Tensor) -> Tensor:
        return 0 * draws


@breaks("episodes_repeat")
class DrawsElsewhere(Lawful):
    def sent(self, situation: Any, draws: Tensor) -> Tensor:
        return super().sent(situation, torch.rand_like(draws))


@breaks("reset_forgets")
class Remembers(Lawful):
    """The first δ it drew, for ever."""

    first: Tensor | None = None

    def sent(self, situation: Any, draws: Tensor) -> Tensor:
        one = draws[:1] if self.first is None else self.first
        self.first = one
        return super().sent(situation, one.expand_as(draws))


@breaks("worlds_are_apart")
class SharesItsDraws(Lawful):
    def sent(self, situation: Any, draws: Tensor) -> Tensor:
        return super().sent(situation, draws.mean(0, keepdim=True).expand_as(draws))


@breaks("every_fleet_is_attacked")
class CountsOnTwo(Lawful):
    def sent(self, situation: Any, draws: Tensor) -> Tensor:
        first, second = super().sent(situation, draws).unbind(1)
        return torch.stack([first, second], dim=1)


@breaks("detector_is_left_alone")
class Trains(Lawful):
    def sent(self, situation: Any, draws: Tensor) -> Tensor:
        with torch.no_grad():
            situation.detector.decoder.head.bias.add_(1e-3)
        return super().sent(situation, draws)


@pytest.mark.parametrize(("rule", "mutant"), MUTANTS, ids=[mutant.__name__ for _, mutant in MUTANTS])
def test_a_mutant_breaks_its_rule(rule: str, mutant: type[agents.Attack], bank: SceneBank) -> None:
    before = {name: tensor.clone() for name, tensor in bank.detector.state_dict().items()}  # type: ignore[attr-defined]
    with pytest.raises(AttackRuleBroken) as caught:
        check_attack(mutant, bank=bank)
    bank.detector.load_state_dict(before)  # type: ignore[attr-defined]
    assert caught.value.rule == rule, str(caught.value)
    assert "the rule: " in str(caught.value)


def test_every_rule_has_a_mutant() -> None:
    assert {rule for rule, _ in MUTANTS} == set(ALL)


def test_lawful_attacks_keep_every_rule(bank: SceneBank) -> None:
    assert check_attack(Lawful, bank=bank) == ALL
    ready = agents.make("noise")
    assert check_attack(ready, bank=bank) == ALL
    assert not hasattr(ready, "_streams") or not ready._streams, "the attack itself was played"


@pytest.mark.slow
@pytest.mark.parametrize("spec", ["random", "bim:steps=2"])
def test_so_do_attacks_that_ship(spec: str, bank: SceneBank) -> None:
    assert check_attack(lambda: agents.make(spec), bank=bank) == ALL


def test_what_raises_is_named_with_its_place(bank: SceneBank) -> None:
    class Broken(Lawful):
        def sent(self, situation: Any, draws: Tensor) -> Tensor:
            raise KeyError("no such cell")

    with pytest.raises(AttackRuleBroken, match="the attack raised KeyError: 'no such cell'") as caught:
        check_attack(Broken, bank=bank)
    assert caught.value.__cause__ is not None
    assert traceback.extract_tb(caught.value.__cause__.__traceback__)[-1].name == "sent"


def test_rules_can_be_skipped_by_name_only(bank: SceneBank) -> None:
    with pytest.raises(ValueError, match=r"no rules called \['norm_kept'\]; the rules are .*norm_is_kept"):
        check_attack(Lawful, bank=bank, skip=["norm_kept"])
