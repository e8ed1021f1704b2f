"""The table in Markdown and JSON, with all that is needed to make it again."""

from __future__ import annotations

import json
import platform
from collections.abc import Sequence
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from cp_env.evaluation.cells import Protocol
from cp_env.evaluation.figures import Row
from cp_env.evaluation.store import write_atomically
from cp_env.intervals import Interval

PACKAGES = ("cp-env", "torch", "numpy", "scipy", "gymnasium", "pettingzoo", "stable-baselines3")

# heading, figure of a row, format
COLUMNS: tuple[tuple[str, str, str], ...] = (
    ("AP@0.5", "ap50", ".3f"),
    ("AP@0.7", "ap70", ".3f"),
    ("recovered", "recovery50", ".2f"),
    ("damage", "damage", ".1f"),
    ("verif./frame", "verifications", ".2f"),
    ("at alarm", "verifications_alarmed", ".2f"),
    ("max", "verifications_max", "d"),
    ("alarms", "alarms", ".2f"),
    ("converged", "converged", ".2f"),
    ("in frames", "frames_to_convergence", ".1f"),
    ("ID", "id_rate", ".2f"),
    ("MC", "mc_rate", ".2f"),
    ("fps", "frames_per_second", ".0f"),
)

LEGEND = """\
Mean and 95 % interval over scenes, each with all of its seeds: bootstrapped for AP and recovery, Student's t elsewhere.

* AP: of the output, strict protocol: every vehicle in range counts, seen or hidden; pooled over frames.
* recovered: share of the AP@0.5 that the attack takes from an undefended ego which the defender restores.
* damage: 1 - Jaccard to the unattacked output, summed over an episode.
* verif./frame: groups looked at, a frame; at alarm: in a frame with at least one; max: in any frame.
* alarms: share of the frames with at least one.
* converged: share of episodes in which the defender came to a conclusion; in frames: of attack, where it did.
* ID, MC: share of the liars, and of the honest, accused when it converged, else in the last frame.
* fps: defended frames a second, the attacker's time left out.

Frames of grace, in which no perturbation acts, count for AP, damage and fps only.
"""


def entry(row: Row, figure: str, spec: str, *, interval: bool = True) -> str:
    """One figure as text: "0.812 [0.790, 0.833]", or "–" where it means nothing."""
    value = getattr(row, figure)
    if value is None:
        return "–"
    if not isinstance(value, Interval):
        return format(value, spec)
    return format(value, spec) if interval else format(value.mean, spec)


def markdown(rows: Sequence[Row]) -> str:
    """The whole table with intervals, and what its columns mean."""
    heads = ["defender", "attack", "k", *(head for head, _, _ in COLUMNS)]
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for row in rows:
        name = row.defender + (f" ({row.n_errors} failed)" if row.n_errors else "")
        cells = [name, row.attack, str(row.k), *(entry(row, figure, spec) for _, figure, spec in COLUMNS)]
        lines.append("| " + " | ".join(cells) + " |")
    size = f"{rows[0].n_scenes} scenes, {rows[0].n_episodes} episodes a row. " if rows else ""
    return "\n".join(lines) + "\n\n" + size + LEGEND


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
    write_atomically(markdown_path, f"{markdown(rows)}\n```sh\n{conditions['command']}\n```\n")
    return json_path, markdown_path


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
