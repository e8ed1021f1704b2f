"""How an evaluation is played: one process, several, or a Ray cluster."""

from __future__ import annotations

from cp_env.evaluation.execution.failures import FailedRuns
from cp_env.evaluation.execution.rollout import Rollout, play
from cp_env.evaluation.execution.runner import execute, execute_all, prepare
from cp_env.evaluation.execution.workers import Workers, open_bank

__all__ = ["FailedRuns", "Rollout", "Workers", "execute", "execute_all", "open_bank", "play", "prepare"]
