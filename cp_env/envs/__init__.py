"""The environments: PettingZoo parallel, Gymnasium single and vectorised, all over one `World`."""

from __future__ import annotations

from cp_env.envs import after_fork  # noqa: F401 (children that are forked compute on one thread)
from cp_env.envs.core import Game
from cp_env.envs.parallel import CollaborativePerceptionEnv
from cp_env.envs.single import JointAdversaryEnv
from cp_env.envs.vector import JointAdversaryVectorEnv

__all__ = ["CollaborativePerceptionEnv", "Game", "JointAdversaryEnv", "JointAdversaryVectorEnv"]
