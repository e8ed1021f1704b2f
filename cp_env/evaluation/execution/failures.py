"""Failures of plug-ins, each reported once: runs that could not be played, and defenders that ended their episodes."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from textwrap import indent

from cp_env.evaluation.plan.records import Record
from cp_env.evaluation.plan.runs import Run
from cp_env.progress import say
from defenders.failure import Failure


@dataclass(frozen=True)
class FailureGroup:
    """Runs that failed in the same way: the same entry, at the same line, with the same text but for its numbers."""

    entry: str
    failure: Failure  # the first of them
    runs: tuple[Run, ...]
    planned: int  # runs of that entry

    def __str__(self) -> str:
        more = len(self.runs) - 1
        where = f"{self.runs[0]}{f'; and {more} more' if more else ''}"
        lines = [
            f"{self.entry} failed in {len(self.runs)} of {self.planned} runs: {self.failure}",
            f"  in: {where}",
            *([indent(self.failure.trace, "  ")] if self.failure.trace else []),
        ]
        return "\n".join(lines)


class FailedRuns(RuntimeError):
    """Some runs could not be played. All others were, and are stored; the next execution tries these again.

    Attributes:
        failed: those runs, and why each failed.
        groups: the same, like failures together.
    """

    def __init__(self, failed: Sequence[tuple[Run, Failure]], planned: Sequence[Run]) -> None:
        self.groups = tuple(group_failures(failed, planned))
        self.failed = tuple((run, failure.reason) for run, failure in failed)
        head = f"{len(failed)} of {len(planned)} runs failed, all others are stored:"
        super().__init__("\n".join([head, *(indent(str(group), "  ") for group in self.groups)]))


def group_failures(failed: Sequence[tuple[Run, Failure]], planned: Sequence[Run]) -> Iterator[FailureGroup]:
    """Like failures together, in the order of the first of each.

    Args:
        failed: runs, and why each failed.
        planned: all runs of the plan.
    """
    groups: dict[tuple[str, str, str], list[tuple[Run, Failure]]] = {}
    for run, failure in failed:
        groups.setdefault((failure.entry, alike(failure.reason), failure.place), []).append((run, failure))
    for members in groups.values():
        runs, failure = tuple(run for run, _ in members), members[0][1]
        entry = failure.entry or _common_entry(runs)
        yield FailureGroup(entry, failure, runs, sum(_met(entry, run) for run in planned))


def alike(text: str) -> str:
    """The text with every number in the same words: equal for errors that differ by frame, vehicle or address."""
    return re.sub(r"0x[0-9a-fA-F]+|\d+(?:\.\d+)?", "#", text)


def _common_entry(runs: Sequence[Run]) -> str:
    """What the runs have in common where it is not known whose failure it was."""
    defenders, attacks = {run.defender for run in runs}, {run.attack for run in runs}
    if len(defenders) == len(attacks) == 1:
        return f"{runs[0].defender} against {runs[0].attack}"
    if len(attacks) == 1:
        return f"attack {runs[0].attack}"
    return f"defender {runs[0].defender}" if len(defenders) == 1 else "several entries"


def _met(entry: str, run: Run) -> bool:
    """Whether the entry plays in the run."""
    known = (f"{run.defender} against {run.attack}", f"attack {run.attack}", f"defender {run.defender}")
    return entry in known or entry == "several entries"


class EpisodeFailures:
    """Says once of each kind of failure that a defender has ended an episode by it, with the traceback."""

    def __init__(self) -> None:
        self._said: set[tuple[str, str, str]] = set()

    def report(self, run: Run, records: Sequence[Record]) -> None:
        """Look at the episodes of a run that was just played."""
        for record in records:
            failure = record.failure
            if failure is None:
                continue
            key = (run.defender, alike(failure.reason), failure.place)
            if key not in self._said:
                self._said.add(key)
                trace = f"\n{indent(failure.trace, '  ')}" if failure.trace else ""
                say(
                    f"defender {run.defender} failed and ended its episode, first on {record.scene} against "
                    f"{run.attack}, k = {run.k}, seed {run.seed}; the others go on: {failure}{trace}"
                )
