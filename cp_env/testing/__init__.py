"""A conformance suite for PettingZoo `ParallelEnv`s, stronger than PettingZoo's own, for others' environments too.

    from cp_env.testing import check_env
    check_env(lambda: my_env(render_mode="rgb_array"))

Each rule is a small function whose docstring states it. `PARALLEL_ENV_RULES` holds for any environment with a
constant set of agents; `CP_ENV_RULES` for ours (perturbations inside the ball, a frozen victim, refusal of bad input),
and is added for them.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Collection
from typing import Any

from cp_env.testing.attack import AttackRuleBroken, check_attack
from cp_env.testing.cp_env_rules import CP_ENV_RULES, is_ours
from cp_env.testing.defender import DefenderRuleBroken, check_defender
from cp_env.testing.detector import DetectorRuleBroken, check_detector
from cp_env.testing.parallel_env import PARALLEL_ENV_RULES, Rule
from cp_env.testing.rollout import Case, Env, Violation
from cp_env.testing.scenes import LAWS, LawBroken, check_scenes

__all__ = [
    "CP_ENV_RULES",
    "LAWS",
    "PARALLEL_ENV_RULES",
    "AttackRuleBroken",
    "DefenderRuleBroken",
    "DetectorRuleBroken",
    "LawBroken",
    "Rule",
    "RuleBroken",
    "check_attack",
    "check_defender",
    "check_detector",
    "check_env",
    "check_scenes",
]


class RuleBroken(AssertionError):
    """An environment does not keep a rule; `rule` is its name."""

    def __init__(self, rule: Rule, what: str) -> None:
        self.rule = rule.__name__
        super().__init__(f"{self.rule}: {what}\n  the rule: {rule.__doc__}")


def check_env(
    env_or_factory: Env | Callable[[], Env], *, steps: int = 12, seed: int = 0, skip: Collection[str] = ()
) -> tuple[str, ...]:
    """Check an environment against every rule that applies to it.

    Args:
        env_or_factory: a `ParallelEnv`, of which deep copies are played and which is left untouched, or a function
            that makes a new instance each time.
        steps: calls of `step` (or of `reset`, where an episode is over) a rule plays; let it exceed an episode.
        seed: seeds the episodes and the random actions.
        skip: names of rules that do not apply, such as "seeds_differ" for a game without chance.

    Returns:
        The names of the rules that were checked, all of them kept.

    Raises:
        RuleBroken: an `AssertionError` that names the first rule broken and says what happened.
        ValueError: an unknown name in `skip`, or no steps.
    """
    if steps < 1:
        raise ValueError(f"steps must be at least 1, got {steps}")
    known = {rule.__name__ for rule in PARALLEL_ENV_RULES + CP_ENV_RULES}
    if unknown := set(skip) - known:
        raise ValueError(f"no rules called {sorted(unknown)}; the rules are {sorted(known)}")
    make: Callable[[], Any] = env_or_factory if callable(env_or_factory) else lambda: copy.deepcopy(env_or_factory)
    rules = [
        rule for rule in PARALLEL_ENV_RULES + (CP_ENV_RULES if is_ours(make()) else ()) if rule.__name__ not in skip
    ]
    case = Case(make, steps, seed)
    for rule in rules:
        _check(rule, case)
    return tuple(rule.__name__ for rule in rules)


def _check(rule: Rule, case: Case) -> None:
    try:
        rule(case)
    except Violation as violation:
        raise RuleBroken(rule, str(violation)) from None
    except Exception as error:
        raise RuleBroken(rule, f"the environment raised {type(error).__name__}: {error}") from error
