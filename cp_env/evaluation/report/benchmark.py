"""The table in Markdown and JSON, with all that is needed to make it again."""

from __future__ import annotations

import json
import platform
from collections.abc import Sequence
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from itertools import groupby
from pathlib import Path
from typing import Any

from rich.table import Table

from cp_env.evaluation.analysis.summary import Row
from cp_env.evaluation.plan.records import write_atomically
from cp_env.evaluation.plan.runs import Protocol
from cp_env.metrics.intervals import Interval

PACKAGES = ("cp-env", "torch", "numpy", "scipy", "gymnasium", "pettingzoo", "stable-baselines3")

# heading, figure of a row, format, whether the short table has it
COLUMNS: tuple[tuple[str, str, str, bool], ...] = (
    ("AP@.5", "ap50", ".3f", True),
    ("AP@.7", "ap70", ".3f", True),
    ("back", "recovery50", ".2f", True),
    ("damage", "damage", ".1f", True),
    ("looks/frame", "verifications", ".2f", False),
    ("looks", "verifications_alarmed", ".2f", True),
    ("most", "verifications_max", "d", True),
    ("alarms", "alarms", ".2f", False),
    ("sure", "converged", ".2f", False),
    ("after", "frames_to_convergence", ".1f", True),
    ("ID", "id_rate", ".2f", True),
    ("MC", "mc_rate", ".2f", True),
    ("fps", "frames_per_second", ".0f", True),
)
SHORT = tuple(column for column in COLUMNS if column[3])

INTERVALS = """\
Mean and 95 % interval over scenes, each with all of its seeds: bootstrapped for AP
and what comes back, Student's t elsewhere, cut at what is possible.
"""

GLOSSARY = """\
* AP: of the output, pooled over frames; every vehicle in range counts, seen or not.
  Counted strictly unless the conditions name another protocol.
* back: share of the AP@.5 lost to the attack by an undefended ego that comes back.
* damage: 1 - Jaccard to the unattacked output, summed over an episode.
* looks: verifications in a frame with at least one; most: in any frame;
  looks/frame: over all frames; alarms: share of frames with at least one.
* sure: share of episodes in which the defender converged; after: frames of attack.
* ID, MC: share of the liars, of the honest, accused when it converged or at the end.
* fps: defended frames a second, the attacker's time left out.

Frames of grace, in which no perturbation acts, count for AP, damage and fps only.
"""


def figure_text(row: Row, figure: str, spec: str, *, interval: bool) -> str:
    """One figure as text: "0.812 [0.790, 0.833]" or "0.812", and "–" where it means nothing."""
    value = getattr(row, figure)
    if value is None:
        return "–"
    if not isinstance(value, Interval):
        return format(value, spec)
    return format(value, spec) if interval else format(value.mean, spec)


def markdown(rows: Sequence[Row], *, short: bool = False) -> str:
    """The table in Markdown: every figure with its interval, or the most telling ones without."""
    columns = SHORT if short else COLUMNS
    heads = ["defender", "attack", "k", *(column[0] for column in columns)]
    lines = ["| " + " | ".join(heads) + " |", "|---|---|" + "--:|" * (len(heads) - 2)]
    for row in rows:
        figures = (figure_text(row, figure, spec, interval=not short) for _, figure, spec, _ in columns)
        lines.append("| " + " | ".join([_name(row), row.attack, str(row.k), *figures]) + " |")
    return "\n".join(lines) + "\n"


def screen(rows: Sequence[Row]) -> Table:
    """The short table for a terminal of eighty columns."""
    made = Table(box=None, padding=(0, 1, 0, 0), pad_edge=False)
    made.add_column("", overflow="fold")
    for head, *_ in SHORT:
        made.add_column(head, justify="right", no_wrap=True)
    for (attack, k), same in groupby(rows, key=lambda row: (row.attack, row.k)):
        game = "nobody lies" if k == 0 else f"{attack}, {k} liar{'s' if k > 1 else ''}"
        made.add_row()
        made.add_row(f"[bold]{game}[/bold]")
        for row in same:
            made.add_row(_name(row), *(figure_text(row, figure, spec, interval=False) for _, figure, spec, _ in SHORT))
    return made


def _name(row: Row) -> str:
    return row.defender + (f" ({row.n_errors} failed)" if row.n_errors else "")


def about(protocol: Protocol, command: str, **notes: Any) -> dict[str, Any]:
    """The conditions, the versions and the machine."""
    return {
        "command": command,
        "protocol": protocol.describe(),
        "versions": {"python": platform.python_version(), **{name: _version(name) for name in PACKAGES}},
        "machine": f"{platform.system()} {platform.machine()}",
        **notes,
    }


def write_report(folder: Path, rows: Sequence[Row], conditions: dict[str, Any]) -> tuple[Path, Path]:
    """`results.json` and `results.md` in `folder`; returns both paths."""
    json_path, markdown_path = folder / "results.json", folder / "results.md"
    data = {"about": conditions, "rows": [asdict(row) for row in rows]}
    write_atomically(json_path, json.dumps(data, indent=1) + "\n")
    size = f"{rows[0].n_scenes} scenes, {rows[0].n_episodes} episodes a row." if rows else "Nothing was played."
    parts = (
        markdown(rows, short=True),
        f"```sh\n{conditions['command']}\n```\n",
        markdown(rows),
        f"{size} {INTERVALS}",
        GLOSSARY,
    )
    write_atomically(markdown_path, "\n".join(parts))
    return json_path, markdown_path


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
