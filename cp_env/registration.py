"""The ids under which gymnasium and pettingzoo find the environment. Registered by string: nothing heavy is loaded.

gymnasium.make(ENV_ID)                     the single-agent view: one joint adversary
gymnasium.make_vec(ENV_ID, num_envs=8)     the same, batched in one forward
pettingzoo.make("parallel", ENV_ID)        one agent per attacker (pettingzoo 1.27 and later have this registry)
pettingzoo.make("aec", ENV_ID)
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium
import pettingzoo

if TYPE_CHECKING:
    from typing import Unpack

    from pettingzoo import AECEnv

    from cp_env.envs.parallel import CollaborativePerceptionEnv
    from cp_env.settings import Options

ENV_ID = "cp_env/CollaborativePerception-v0"


def register_ids() -> None:
    """Make `ENV_ID` known to gymnasium and, where it keeps a registry, to pettingzoo. Doing it twice does nothing."""
    if ENV_ID not in gymnasium.registry:
        gymnasium.register(
            ENV_ID,
            entry_point="cp_env.envs.single:JointAdversaryEnv",
            vector_entry_point="cp_env.envs.vector:JointAdversaryVectorEnv",
        )
    if hasattr(pettingzoo, "register"):
        if ENV_ID not in pettingzoo.parallel_registry:
            pettingzoo.register("parallel", ENV_ID, "cp_env.registration:make_parallel")
        if ENV_ID not in pettingzoo.aec_registry:
            pettingzoo.register("aec", ENV_ID, "cp_env.registration:make_aec")


def make_parallel(*, max_cycles: int | None = None, **options: Unpack[Options]) -> CollaborativePerceptionEnv:
    """`cp_env.parallel_env` for `pettingzoo.make`, whose word for `max_frames` is `max_cycles`."""
    from cp_env import parallel_env

    if max_cycles is not None:
        options["max_frames"] = max_cycles
    return parallel_env(**options)


def make_aec(*, max_cycles: int | None = None, **options: Unpack[Options]) -> AECEnv[str, Any, Any]:
    """`cp_env.env` for `pettingzoo.make`, whose word for `max_frames` is `max_cycles`."""
    from cp_env import env

    if max_cycles is not None:
        options["max_frames"] = max_cycles
    return env(**options)
