"""The driving table in Markdown: what damage and AP do not see."""

from __future__ import annotations

from collections.abc import Sequence

from cp_env.evaluation.analysis.driving import DrivingRow
from cp_env.evaluation.analysis.summary import Row
from cp_env.metrics.intervals import Interval

# heading, metric of a row, format
COLUMNS: tuple[tuple[str, str, str], ...] = (
    ("critical recall", "critical_recall", ".3f"),
    ("critical AP@.5", "critical_ap", ".3f"),
    ("certified recall", "certified", ".3f"),
    ("removal", "removal", ".2f"),
    ("spoofing", "spoofing", ".2f"),
    ("streak", "streak", ".1f"),
    ("MDR", "mdr", ".2f"),
    ("MDR > 4", "mdr_hard", ".2f"),
    ("FSR", "fsr", ".1f"),
    ("collisions", "collisions", ".2f"),
    ("hard brakings", "hard_brakings", ".2f"),
    ("min. TTC", "min_time_to_collision", ".1f"),
    ("mean speed", "mean_speed", ".2f"),
    ("AUC", "auc", ".3f"),
    ("TPR at 3 % FPR", "tpr_at_3", ".2f"),
    ("decodes/frame", "decodes", ".2f"),
    ("ms/frame", "milliseconds", ".1f"),
    ("late frames", "late", ".2f"),
)

DRIVING = """\
* critical recall, critical AP@.5: over the vehicles within 10 m in the ego's corridor,
  or with a time to collision below 4 s; others count neither way.
* certified recall: share of the vehicles that at least 2k + 1 single views find. No k
  attackers can hide them from an ego that lets the views vote, whatever they send. It
  depends on scenes, detector and fleet, not on defender or attack.
* removal: share of the frames in which the nearest vehicle is missing that the
  unattacked output finds; spoofing: share of the frames with a ghost where a standing
  car would be critical; streak: most consecutive frames of either.
* MDR: hardest braking (m/s²) that a vehicle demands which is missed for three frames or
  more; MDR > 4: share of the episodes above 4 m/s². FSR: speed (m/s in a minute) lost
  to ghosts that last three frames or more.
* collisions (share of the episodes), hard brakings (an episode, above 4 m/s²), min. TTC
  (s), mean speed (m/s): of the pseudo-closed loop, in which the ego follows its recorded
  path behind the leaders that it perceives and all others replay.
* AUC, TPR at 3 % FPR: of the defender's belief, a vehicle and frame each; benign ones
  are those of the runs without an attack, where there are any.
* decodes/frame: groups perceived. ms/frame: the time of perceiving and defending; late
  frames: share of those that take over 100 ms.
"""


def driving_cells(row: DrivingRow) -> list[tuple[str, float | None]]:
    """The text and the value of each column; "–" and None where it has no meaning."""
    values = [(getattr(row, metric), spec) for _, metric, spec in COLUMNS]
    return [_cell(value, spec) for value, spec in values]


def driving_markdown(rows: Sequence[Row]) -> str:
    """The table of those rows that have recorded the driving, and what its columns are; empty if none has."""
    driven = [(row, row.driving) for row in rows if row.driving is not None]
    if not driven:
        return ""
    heads = ["defender", "attack", "k", *(heading for heading, *_ in COLUMNS)]
    lines = ["| " + " | ".join(heads) + " |", "|---|---|" + "--:|" * (len(heads) - 2)]
    for row, driving in driven:
        cells = [row.defender, row.attack, str(row.k), *(text for text, _ in driving_cells(driving))]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(["Driving:", "", *lines, "", DRIVING])


def _cell(value: Interval | float | None, spec: str) -> tuple[str, float | None]:
    if value is None:
        return "–", None
    return format(value, spec), value.mean if isinstance(value, Interval) else value
