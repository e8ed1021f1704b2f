"""Every defender × action map × observation keeps every rule of our own suite."""

from __future__ import annotations

from collections.abc import Callable

import pytest

import defenders
from cp_env.envs.parallel import CollaborativePerceptionEnv
from cp_env.settings import ACTIONS, OBSERVATIONS
from cp_env.testing import CP_ENV_RULES, PARALLEL_ENV_RULES, check_env

RULES = {rule.__name__ for rule in PARALLEL_ENV_RULES + CP_ENV_RULES}
Make = Callable[..., CollaborativePerceptionEnv]


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.parametrize("observation", OBSERVATIONS)
@pytest.mark.parametrize("action", ACTIONS)
@pytest.mark.parametrize("defender", defenders.names())
def test_every_combination_keeps_every_rule(toy_env: Make, defender: str, action: str, observation: str) -> None:
    checked = check_env(lambda: toy_env(defender, action=action, observation=observation), steps=5)
    assert set(checked) == RULES
