"""The same results where the ego is a benign vehicle and where it is an attacker itself.

An ego that attacks perturbs the one map that it never leaves out. What a defence is worth shows in the other episodes,
and the spread over all of them is mostly that of the two cases.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from cp_env.evaluation.analysis.summary import Row, summarise
from cp_env.evaluation.plan.records import Record
from cp_env.evaluation.plan.runs import NO_ATTACK, Run

EGO = 0
"""The ego's number among the vehicles of an episode."""


@dataclass(frozen=True)
class Stratum:
    """The rows over a part of the episodes."""

    name: str  # in JSON
    title: str
    rows: Sequence[Row]  # those under an attack, of which the part has episodes


def strata(results: Mapping[Run, Sequence[Record]], *, resamples: int = 1000) -> list[Stratum]:
    """The rows where the ego is benign, and where it is an attacker, if there are episodes of both; else nothing.

    The AP that recovery is measured by is that of the same scenes without an attack.

    Args:
        results: the episodes of each run.
        resamples: Dirichlet weights of the intervals of AP.
    """
    found = []
    for name, title, attacks in (
        ("ego_benign", "Episodes in which the ego is benign", False),
        ("ego_attacker", "Episodes in which the ego is an attacker", True),
    ):
        part = {
            run: tuple(r for r in records if run.attack == NO_ATTACK or (EGO in r.attackers) is attacks)
            for run, records in results.items()
        }
        rows = summarise({run: records for run, records in part.items() if records}, resamples=resamples)
        found.append(Stratum(name, title, [row for row in rows if row.attack != NO_ATTACK]))
    return found if all(stratum.rows for stratum in found) else []
