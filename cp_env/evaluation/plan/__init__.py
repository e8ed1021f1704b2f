"""What an evaluation plays, and what is stored of it."""

from __future__ import annotations

from cp_env.evaluation.plan.grid import Axes, Grid
from cp_env.evaluation.plan.records import Record, Store
from cp_env.evaluation.plan.runs import Conditions, Run, plan_runs

__all__ = ["Axes", "Conditions", "Grid", "Record", "Run", "Store", "plan_runs"]
