"""Environments: their options, the options and seeds of a reset, and actions, on toy scenes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from agents.sb3 import AdversaryVecEnv, make_vec_env
from cp_env.envs.parallel import CollaborativePerceptionEnv
from cp_env.envs.single import JointAdversaryEnv
from cp_env.envs.vector import JointAdversaryVectorEnv
from cp_env.settings import OPTION_NAMES
from tests.campaign.inputs.names import value
from tests.campaign.inputs.trial import Try
from tests.campaign.values import number, strange
from tests.helpers.toy_evaluation import toy_bank

TAKEN = 0.02
"""Share of actions that are as they should be: those play a frame, which takes time."""


def options(folder: Path) -> Try:
    """Options at the constructors of the four environments."""
    del folder
    bank = toy_bank()
    makers: tuple[Callable[..., Any], ...] = (
        lambda **given: CollaborativePerceptionEnv("none", **given),
        lambda **given: JointAdversaryEnv("none", **given),
        lambda **given: JointAdversaryVectorEnv(2, "none", **given),
        lambda **given: make_vec_env(2, "none", **given),
    )
    usual = [name for name in OPTION_NAMES if name not in ("scenes", "detector", "checkpoint", "device")]

    def one(rng: Random) -> bool:
        given = {name: value(rng, name) for name in rng.sample([*usual, "n_atackers"], rng.randint(1, 3))}
        if rng.random() < 0.1:
            given[rng.choice(["scenes", "detector", "checkpoint", "device"])] = strange(rng)
            rng.choice(makers)(**given)
        else:
            rng.choice(makers)(bank=bank, **given).close()
        return True

    return one


def environments() -> list[Any]:
    """The four environments."""
    bank, small = toy_bank(), {"action": "basis", "n_attackers": 1, "max_frames": 2}
    return [
        CollaborativePerceptionEnv("none", bank=bank, **small),
        JointAdversaryEnv("none", bank=bank, **small),
        JointAdversaryVectorEnv(2, "none", bank=bank, **small),
        make_vec_env(2, "none", bank=bank, **small),
    ]


def resets(folder: Path) -> Try:
    """Seeds and options of a reset; one that is refused leaves the episode as it was."""
    del folder
    made = environments()[:3]
    for env in made:
        env.reset(seed=0)
    keys = ("scene", "start", "absent", "strat", "options", "reset_mask", 3)

    def one(rng: Random) -> bool:
        env = rng.choice(made)
        given: Any = strange(rng)
        if rng.random() < 0.7:
            usual = {"scene": "toy-1", "start": 1, "absent": {0: [1]}, "options": 1, "reset_mask": [True, False]}
            given = {}
            for key in rng.sample(keys, rng.randint(0, 2)):
                given[key] = rng.choice([usual.get(key), number(rng), strange(rng)])
        seed = rng.choice([None, None, 3, number(rng), strange(rng)])
        before = clock(env)
        try:
            env.reset(seed=seed, options=given)
        except (ValueError, TypeError):
            assert clock(env) == before, "a refused reset changed the episode"
            raise
        return True

    return one


def clock(env: Any) -> list[tuple[Any, ...]]:
    """Where every world is."""
    return [(s.scene, s.start, s.frame, s.attackers) for s in env.game.world._worlds]


def actions(folder: Path) -> Try:
    """Actions of the four environments; those that are taken play a frame."""
    del folder
    made = environments()
    for env in made:
        begin(env)

    def one(rng: Random) -> bool:
        env = rng.choice(made)
        given: Any = strange(rng) if rng.random() < 0.7 else numbers(rng)
        if rng.random() < TAKEN:
            given = np.zeros(16, np.float32)
        if isinstance(env, CollaborativePerceptionEnv):
            over = any(env.step(rng.choice([{"adversary_0": given}, {"adversary_0": given}, given]))[3].values())
        elif isinstance(env, JointAdversaryEnv):
            over = env.step(given)[3]
        elif isinstance(env, AdversaryVecEnv):
            env.step(rng.choice([[given, given], given]))
            over = False
        else:
            env.step(rng.choice([[given, given], given]))
            over = False
        if over:
            begin(env)
        return True

    return one


def begin(env: Any) -> None:
    env.reset() if isinstance(env, AdversaryVecEnv) else env.reset(seed=0)


def numbers(rng: Random) -> Any:
    """About as many numbers as an action has, nested in some way."""
    flat = [number(rng) for _ in range(rng.choice([0, 1, 15, 16, 17, 32]))]
    return rng.choice([flat, tuple(flat), [flat], [flat, flat[:-1]]])
