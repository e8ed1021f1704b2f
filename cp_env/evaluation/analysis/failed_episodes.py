"""Episodes that a defender's own failure ended, like failures together, from the records alone."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence

from cp_env.evaluation.execution.failures import alike
from cp_env.evaluation.plan.records import Record
from cp_env.evaluation.plan.runs import Run
from defenders.failure import one_line


def failed_episodes(results: Iterable[Mapping[Run, Sequence[Record]]]) -> tuple[str, ...]:
    """A line for each defender and kind of failure, with the text of the first.

    Args:
        results: the episodes of each run, of each grid.
    """
    played: dict[str, int] = {}
    groups: dict[tuple[str, str], list[str]] = {}
    for run, records in ((run, of) for grid in results for run, of in grid.items()):
        played[run.defender] = played.get(run.defender, 0) + len(records)
        for record in records:
            if record.error is not None:
                text = _without_frame(record.error)
                groups.setdefault((run.defender, alike(text)), []).append(text)
    return tuple(
        one_line(f"defender {defender} ended {len(texts)} of its {played[defender]} episodes: {texts[0]}")
        for (defender, _), texts in groups.items()
    )


def _without_frame(error: str) -> str:
    """What went wrong and where, without the defender's class and the frame: those are said apart, and differ."""
    return re.sub(r"^defender \S+ failed in frame \d+: ", "", error)
