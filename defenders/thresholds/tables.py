"""Similarity thresholds ε: one for every group, or one for each size of group.

A view of few vehicles resembles the reference less than a view of many, whether it is contaminated or not. So with one
ε a large contaminated group passes or a small uncontaminated one fails. How much they differ depends on how the ego
fuses. `thresholds.json` holds, for every fusion that ships, a threshold per group size, calibrated on clean and
attacked calibration scenes:

    {"mean": {"source": "which scenes and detector", "command": "the command that wrote this entry",
              "epsilon": {"1": 0.30, "2": 0.41, "3": 0.47}},
     "max": …}
"""

from __future__ import annotations

import copy
import json
from collections.abc import Mapping
from pathlib import Path

CALIBRATED = Path(__file__).with_name("thresholds.json")
EGO_ONLY = {score: Path(__file__).with_name(f"ego_{score}.json") for score in ("agreement", "similarity")}
"""The same for a group with the ego, compared with the ego-only view: the reference of ROBOSAC and PASAC."""

DEFAULT = "mean"
"""The fusion whose thresholds serve until a defender is configured for another, and for one without an entry."""


class Thresholds:
    """ε for a group of a given size. A group larger than any calibrated one gets the threshold of the largest."""

    def __init__(self, epsilon: Mapping[int, float], others: Mapping[str, Mapping[int, float]] | None = None) -> None:
        """`others` take the place of `epsilon` under the fusions that they name.

        Sizes must run from 1 without a gap and every ε lie in [0, 1]; ValueError otherwise.
        """
        self.epsilon = self._default = _checked(epsilon)
        self._others = {fusion: _checked(table) for fusion, table in (others or {}).items()}

    def __call__(self, group: frozenset[int]) -> float:
        return self.epsilon[min(len(group), len(self.epsilon))]

    def of(self, fusion: str) -> Thresholds:
        """The thresholds for an ego with this fusion."""
        made = copy.copy(self)
        made.epsilon = self._others.get(fusion, self._default)
        return made


def _checked(epsilon: Mapping[int, float]) -> dict[int, float]:
    sizes = sorted(epsilon)
    if not sizes or sizes != list(range(1, len(sizes) + 1)):
        raise ValueError(f"thresholds must name every group size from 1 on, got sizes {sizes}; add the missing ones")
    for size in sizes:
        if not 0 <= epsilon[size] <= 1:
            raise ValueError(f"a threshold is a Jaccard similarity in [0, 1], got {epsilon[size]} for size {size}")
    return {size: float(epsilon[size]) for size in sizes}


def open_thresholds(threshold: str | Mapping[int, float], epsilon: float, calibrated: Path = CALIBRATED) -> Thresholds:
    """`"paper"`: `epsilon` for every size; `"calibrated"`: the file of that name; or a mapping from size to ε."""
    if isinstance(threshold, Mapping):
        return Thresholds({int(size): value for size, value in threshold.items()})
    if threshold == "paper":
        return Thresholds({1: epsilon})
    if threshold == "calibrated":
        return read_thresholds(calibrated)
    raise ValueError(f'threshold must be "paper", "calibrated" or a mapping from group size to ε, got {threshold!r}')


def read_thresholds(path: Path) -> Thresholds:
    """Read a thresholds file; ValueError naming the file where it is missing or broken."""
    try:
        entries = json.loads(path.read_text(encoding="utf-8"))
        tables = {
            fusion: {int(size): float(value) for size, value in entry["epsilon"].items()}
            for fusion, entry in entries.items()
        }
        return Thresholds(tables[DEFAULT], tables)
    except FileNotFoundError as error:
        raise ValueError(f"no calibrated thresholds at {path}; pass a mapping from group size to ε") from error
    except (json.JSONDecodeError, KeyError, TypeError, AttributeError, ValueError) as error:
        raise ValueError(f"broken thresholds file {path}: {error!r}; restore it or pass a mapping") from error


def write_thresholds(path: Path, fusion: str, epsilon: Mapping[int, float], *, source: str, command: str) -> None:
    """Put the entry of one fusion into a thresholds file, which is made if it is not there; the others stay."""
    entries = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    entries[fusion] = {"source": source, "command": command, "epsilon": _checked(epsilon)}
    draft = path.with_suffix(".part")
    draft.write_text(json.dumps(entries, indent=1) + "\n", encoding="utf-8")
    draft.replace(path)
