"""Evaluation of defenders against attacks on equal terms: plan, execution, analysis, report.

    conditions = Conditions(scenes="town/test", names=("…",), frames=100)
    runs = plan_runs(conditions, defenders=("none", "prbi"), attacks=("none", "pgd"), ks=(1, 2), seeds=(0,))
    store = Store("out")
    for run in execute(runs, conditions, store, Workers(make_attack=agents.make)): ...
    rows = summarise(store.load(runs, conditions))

An attack comes from outside: this package knows its interface (`reset`, `act`), not where it is made.
"""

from __future__ import annotations

from cp_env.attack import Attack, Learned
from cp_env.evaluation.analysis.strata import strata
from cp_env.evaluation.analysis.summary import Row, mean_ap, summarise
from cp_env.evaluation.execution.failures import FailedRuns
from cp_env.evaluation.execution.rollout import Rollout, play
from cp_env.evaluation.execution.runner import execute, execute_all, prepare
from cp_env.evaluation.execution.workers import Workers, open_bank
from cp_env.evaluation.plan.records import Record, Store
from cp_env.evaluation.plan.runs import Conditions, Run, plan_runs
from cp_env.evaluation.report.benchmark import about, markdown, screen, write_report

__all__ = [
    "Attack",
    "Conditions",
    "FailedRuns",
    "Learned",
    "Record",
    "Rollout",
    "Row",
    "Run",
    "Store",
    "Workers",
    "about",
    "execute",
    "execute_all",
    "markdown",
    "mean_ap",
    "open_bank",
    "plan_runs",
    "play",
    "prepare",
    "screen",
    "strata",
    "summarise",
    "write_report",
]
