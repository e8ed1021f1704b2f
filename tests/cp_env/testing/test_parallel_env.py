"""Every rule of the conformance suite can fail: for each there are mutants of a lawful environment that break it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pettingzoo.test.example_envs import generated_agents_parallel_v0

from cp_env.testing import CP_ENV_RULES, PARALLEL_ENV_RULES, RuleBroken, check_env
from tests.helpers import cp_env_mutants, parallel_env_mutants
from tests.helpers.lawful_env import MUTANTS, Lawful

ALL = {rule.__name__ for rule in PARALLEL_ENV_RULES + CP_ENV_RULES}


def test_a_lawful_environment_keeps_every_rule() -> None:
    assert set(check_env(Lawful)) == ALL
    assert set(check_env(Lawful())) == ALL, "an instance will do for a factory"


def test_the_instance_checked_is_left_untouched() -> None:
    env = Lawful()
    first, _ = env.reset(seed=3)
    check_env(env)
    assert env.frame == 0 and env.agents == env.possible_agents
    assert np.array_equal(env.state(), first["adversary_0"]["place"])


def test_rules_can_be_skipped_by_name_only() -> None:
    assert "seeds_differ" not in check_env(Lawful, skip=["seeds_differ"])
    with pytest.raises(ValueError, match=r"no rules called.*seeds_difer.*the rules are.*seeds_differ"):
        check_env(Lawful, skip=["seeds_difer"])
    with pytest.raises(ValueError, match="steps must be at least 1, got 0"):
        check_env(Lawful, steps=0)


@pytest.mark.parametrize(("rule", "mutant"), MUTANTS, ids=[mutant.__name__ for _, mutant in MUTANTS])
def test_a_mutant_breaks_its_rule(rule: str, mutant: type[Lawful]) -> None:
    with pytest.raises(RuleBroken) as caught:
        check_env(mutant, steps=6)
    assert caught.value.rule == rule, str(caught.value)
    assert "the rule: " in str(caught.value)


def test_every_rule_has_a_mutant() -> None:
    assert {rule for rule, _ in MUTANTS} == ALL
    assert {mutant.__module__ for _, mutant in MUTANTS} == {parallel_env_mutants.__name__, cp_env_mutants.__name__}


def test_somebody_elses_environment_is_checked_too() -> None:
    """PettingZoo's example of agents that come and go: just what SuperSuit, RLlib and TorchRL cannot work with."""
    with pytest.raises(RuleBroken, match=r"spaces_are_fixed|agents_are_constant"):
        check_env(generated_agents_parallel_v0.parallel_env)


class Foreign(Lawful):
    @property
    def game(self) -> Any:
        raise AttributeError("game")


def test_our_own_rules_are_left_out_for_others() -> None:
    assert set(check_env(Foreign)) == {rule.__name__ for rule in PARALLEL_ENV_RULES}
