"""The report of a benchmark in Markdown and JSON, with all that is needed to make it again."""

from __future__ import annotations

import json
import platform
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from itertools import groupby
from pathlib import Path
from typing import Any

from rich.table import Table

from cp_env.evaluation.analysis.measures import MEASURES
from cp_env.evaluation.analysis.strata import Stratum
from cp_env.evaluation.analysis.summary import Row
from cp_env.evaluation.plan.files import write_atomically
from cp_env.evaluation.plan.runs import Conditions
from cp_env.evaluation.report.driving import driving_markdown
from cp_env.metrics.intervals import Interval

PACKAGES = ("cp-env", "torch", "numpy", "scipy", "gymnasium", "pettingzoo", "stable-baselines3")

# heading, metric of a row, format, whether the short table has it
COLUMNS: tuple[tuple[str, str, str, bool], ...] = (
    ("AP@.5", "ap50", ".3f", True),
    ("AP@.7", "ap70", ".3f", True),
    ("AP recovery", "recovery50", ".2f", True),
    ("detection loss/frame", "damage", ".3f", True),
    *((measure.heading, measure.name, measure.spec, False) for measure in MEASURES.values() if measure.column),
    ("verifications/frame", "verifications", ".2f", False),
    ("verifications/alarm", "verifications_alarmed", ".2f", True),
    ("max. verifications", "verifications_max", "d", True),
    ("alarm rate", "alarm_rate", ".2f", False),
    ("convergence rate", "convergence_rate", ".2f", False),
    ("frames to convergence", "frames_to_convergence", ".1f", True),
    ("ID rate (TPR)", "id_rate", ".2f", True),
    ("MC rate (FPR)", "mc_rate", ".2f", True),
    ("fps", "frames_per_second", ".0f", True),
)
SHORT = tuple(column for column in COLUMNS if column[3])
NARROW = {
    "AP recovery": "AP\nrecov.",
    "detection loss/frame": "loss\n/frame",
    "verifications/alarm": "verif.\n/alarm",
    "max. verifications": "max.\nverif.",
    "frames to convergence": "frames\nto\nconv.",
}
"""Headings abbreviated for a terminal of eighty columns; the others break at their spaces."""

INTERVALS = """\
Mean and 95 % interval over scenes, each with all of its seeds. Shares, AP among them,
have Gaffke's interval, which stays in [0, 1] and covers at least 95 % of the time on
every kind of sample that was tried. It has width even where all scenes agree: what
did not happen in 9 of them may still happen in a third. Counts have Student's t, cut
at 0; AP recovery has Student's t over its jackknife values. A rate of episodes, as
"0 of 9", has the exact bounds of Clopper and Pearson. The intervals are of single
values. Two entries that played the same episodes differ by less than their intervals
suggest.
"""

ENDED = """\
A defender that fails ends its episode there. In a ranking the frames that are missing count as if nothing had been \
found in them."""
GLOSSARY = """\
* AP: of the output, pooled over frames; every vehicle in range counts, seen or not.
  Counted strictly unless the conditions name another AP protocol.
* AP recovery: share of the AP@.5 that an undefended ego loses to the attack and the
  defended one keeps.
* detection loss/frame: damage, 1 - Jaccard to the unattacked output, mean over the
  frames of an episode.
* verifications/frame: over all frames; verifications/alarm: over the frames with at
  least one; max. verifications: in any frame; alarm rate: share of frames with one.
* convergence rate: share of episodes in which the defender converged; frames to
  convergence: frames of attack until then.
* ID rate (TPR), MC rate (FPR): share of the attackers, of the benign vehicles, flagged
  when it converged or at the end.
* fps: defended frames a second, the attack's time left out.

Frames of grace, in which no perturbation acts, count for AP, detection loss and fps
only. Rankings leave them out of the detection loss, too.
"""


def metric_text(row: Row, metric: str, spec: str, *, interval: bool) -> str:
    """One value as text: "0.812 [0.790, 0.833]" or "0.812", and "–" where it has no meaning."""
    value = row.value(metric)
    if value is None:
        return "–"
    if not isinstance(value, Interval) or interval:
        return format(value, spec)
    return format(value.mean, spec) if value.hits is None else f"{value.hits} of {value.n}"


def markdown(rows: Sequence[Row], *, short: bool = False) -> str:
    """The table in Markdown: every value with its interval, or a short table without."""
    columns = SHORT if short else COLUMNS
    heads = ["defender", "attack", "k", *(column[0] for column in columns)]
    lines = ["| " + " | ".join(heads) + " |", "|---|---|" + "--:|" * (len(heads) - 2)]
    for row in rows:
        values = (metric_text(row, metric, spec, interval=not short) for _, metric, spec, _ in columns)
        lines.append("| " + " | ".join([_name(row), row.attack, str(row.k), *values]) + " |")
    return "\n".join(lines) + "\n"


def screen(rows: Sequence[Row]) -> Table:
    """The short table for a terminal of eighty columns."""
    made = Table(box=None, padding=(0, 1, 0, 0), pad_edge=False)
    made.add_column("", overflow="fold")
    for head, *_ in SHORT:
        made.add_column(NARROW.get(head, head.replace(" ", "\n")), justify="right", no_wrap=True)
    for (attack, k), same in groupby(rows, key=lambda row: (row.attack, row.k)):
        game = "no attack" if k == 0 else f"{attack}, {k} attacker{'s' if k > 1 else ''}"
        made.add_row()
        made.add_row(f"[bold]{game}[/bold]")
        for row in same:
            made.add_row(_name(row), *(metric_text(row, metric, spec, interval=False) for _, metric, spec, _ in SHORT))
    return made


def _name(row: Row) -> str:
    return row.defender + (f" ({row.n_errors} failed)" if row.n_errors else "")


def about(conditions: Conditions, command: str, **notes: Any) -> dict[str, Any]:
    """The conditions, the versions and the machine."""
    return {
        "command": command,
        "conditions": conditions.describe(),
        "versions": {"python": platform.python_version(), **{name: _version(name) for name in PACKAGES}},
        "machine": f"{platform.system()} {platform.machine()}",
        **notes,
    }


def ended_markdown(texts: Sequence[str]) -> str:
    """What `failed_episodes` gives, with what it means, in Markdown; no text ends the block of code."""
    lines = "\n".join(text.replace("`", "'") for text in texts)
    return f"**Failed episodes.** {ENDED}\n\n```\n{lines}\n```\n"


def write_report(
    folder: Path,
    rows: Sequence[Row],
    provenance: dict[str, Any],
    strata: Sequence[Stratum] = (),
    ended: Sequence[str] = (),
) -> tuple[Path, Path]:
    """Write `results.json` and `results.md`.

    Args:
        folder: where to.
        rows: of the table.
        provenance: what `about` gives.
        strata: the same rows over the episodes where the ego is, and is not, an attacker.
        ended: which defenders failed and ended episodes: see `failed_episodes`.

    Returns:
        Both paths.
    """
    json_path, markdown_path = folder / "results.json", folder / "results.md"
    apart = {stratum.name: [row.to_json() for row in stratum.rows] for stratum in strata}
    data = {"about": provenance, "rows": [row.to_json() for row in rows], **({"strata": apart} if apart else {})}
    data |= {"failed_episodes": list(ended)} if ended else {}
    write_atomically(json_path, json.dumps(data, indent=1) + "\n")
    size = f"{rows[0].n_scenes} scenes, {rows[0].n_episodes} episodes a row." if rows else "Nothing was played."
    parts = (
        markdown(rows, short=True),
        f"```sh\n{provenance['command']}\n```\n",
        *([ended_markdown(ended)] if ended else []),
        markdown(rows),
        f"{size} {INTERVALS}",
        *(f"{stratum.title}:\n\n{markdown(stratum.rows)}" for stratum in strata),
        GLOSSARY,
        driving_markdown(rows),
    )
    write_atomically(markdown_path, "\n".join(parts))
    return json_path, markdown_path


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
