"""The ids, the constructors, and what importing costs."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pettingzoo
import pytest
from pettingzoo.utils.env import AECEnv

import cp_env
from agents.sb3 import make_vec_env
from cp_env.envs.parallel import CollaborativePerceptionEnv
from cp_env.envs.single import JointAdversaryEnv
from cp_env.envs.vector import JointAdversaryVectorEnv
from cp_env.registration import ENV_ID, make_aec, make_parallel
from cp_env.settings import DEFAULTS, OPTION_NAMES
from cp_env.world.scene_cache import SceneBank
from tests.cp_env.conftest import FRAMES


def test_gymnasium_knows_the_id(bank: SceneBank) -> None:
    env = gymnasium.make(ENV_ID, bank=bank, max_frames=FRAMES, n_attackers=1)
    assert isinstance(env.unwrapped, JointAdversaryEnv)
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)


@pytest.mark.skipif(not hasattr(pettingzoo, "make"), reason="this pettingzoo keeps no registry")
def test_pettingzoo_knows_the_id(toy_town: None) -> None:
    env = pettingzoo.make("parallel", ENV_ID, max_cycles=3)
    assert isinstance(env, CollaborativePerceptionEnv) and env.game.settings.max_frames == 3
    aec = pettingzoo.make("aec", ENV_ID)
    assert isinstance(aec, AECEnv) and isinstance(aec.unwrapped, CollaborativePerceptionEnv)
    assert make_parallel().game.settings.max_frames == 100
    assert make_aec(max_cycles=2).unwrapped.game.settings.max_frames == 2


def test_registering_twice_does_nothing() -> None:
    """Nor does it warn, which would fail this test."""
    importlib.reload(cp_env)
    assert ENV_ID in gymnasium.registry


def test_the_three_constructors(toy_town: None) -> None:
    env = cp_env.parallel_env("none", n_attackers=1, max_frames=2, action="full")
    assert env.possible_agents == ["adversary_0"]
    aec = cp_env.env("none", n_attackers=1, max_frames=2, action="full")
    aec.reset(seed=0)
    observations, _ = env.reset(seed=0)
    assert np.array_equal(aec.last()[0]["features"], observations["adversary_0"]["features"])
    envs = cp_env.vector_env(2, "none", max_frames=2)
    assert isinstance(envs, JointAdversaryVectorEnv) and envs.num_envs == 2


def test_no_module_hides_a_constructor() -> None:
    """Importing a module `cp_env.x` would put it where the function `cp_env.x` was."""
    modules = {module.name for module in pkgutil.iter_modules(cp_env.__path__)}
    assert not modules & set(cp_env.__all__)


def test_every_option_has_a_default_and_an_explanation() -> None:
    """The keywords are those of `Options`; their defaults stand in `cp_env.settings` alone, and in the docstring."""
    assert set(DEFAULTS) == set(OPTION_NAMES)
    documented = inspect.getdoc(cp_env.parallel_env) or ""
    for name, value in DEFAULTS.items():
        written = f'"{value}"' if isinstance(value, str) else str(value)
        assert f"* `{name}` ({written}" in documented, name


@pytest.mark.parametrize(
    ("make", "args"), [(cp_env.parallel_env, ()), (cp_env.env, ()), (cp_env.vector_env, (2,)), (make_vec_env, (2,))]
)
def test_a_misspelt_option_names_the_nearest(make: Callable[..., Any], args: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"unknown option 'knowlege' .did you mean 'knowledge'"):
        make(*args, knowlege="white-box")


def loaded(statement: str) -> set[str]:
    """Names of the modules that are there after a statement was run in a fresh interpreter."""
    code = f"{statement}\nimport sys\nprint(*sys.modules)"
    root = Path(__file__).parents[2]
    run = subprocess.run(
        [sys.executable, "-c", code], cwd=root, capture_output=True, text=True, timeout=120, check=True
    )
    return set(run.stdout.split())


@pytest.mark.parametrize(
    "statement", ["import cp_env", "import cp_env.cli", "from cp_env import parallel_env, vector_env"]
)
def test_import_is_light(statement: str) -> None:
    heavy: Any = {
        "torch",
        "matplotlib",
        "scipy",
        "jaxtyping",
        "tyro",
        "rich",
        "PIL",
        "cp_env.envs.core",
        "stable_baselines3",
    }
    assert not heavy & loaded(statement)


def test_training_needs_neither_window_nor_pictures() -> None:
    assert not {"matplotlib", "tyro", "rich"} & loaded(
        "import cp_env.envs.parallel, cp_env.envs.single, cp_env.envs.vector"
    )
