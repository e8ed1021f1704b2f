"""Defenders × attacks × liars on equal terms: the plan, the play, the figures, the report.

    protocol = Protocol(scenes="town/test", names=("…",), frames=100)
    cells = plan(protocol, defenders=("none", "prbi"), attacks=("none", "pgd"), ks=(1, 2), seeds=(0,))
    store = Store("out")
    for cell in run(cells, protocol, store, Crew(make_attacker=agents.make)): ...
    rows = summarise(store.load(cells, protocol))

An attacker comes from outside: this package knows what it does (`reset`, `act`), not where it is made.
"""

from __future__ import annotations

from cp_env.attack import Attacker, Learned
from cp_env.evaluation.analysis.summary import Row, mean_ap, summarise
from cp_env.evaluation.execution.rollout import Stage, play
from cp_env.evaluation.execution.runner import FailedCells, prepare, run, run_all
from cp_env.evaluation.execution.workers import Crew, open_bank
from cp_env.evaluation.plan.records import Record, Store
from cp_env.evaluation.plan.runs import Cell, Protocol, parse, plan
from cp_env.evaluation.report.benchmark import about, markdown, screen, write_report

__all__ = [
    "Attacker",
    "Cell",
    "Crew",
    "FailedCells",
    "Learned",
    "Protocol",
    "Record",
    "Row",
    "Stage",
    "Store",
    "about",
    "markdown",
    "mean_ap",
    "open_bank",
    "parse",
    "plan",
    "play",
    "prepare",
    "run",
    "run_all",
    "screen",
    "summarise",
    "write_report",
]
