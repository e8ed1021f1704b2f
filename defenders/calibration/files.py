"""Calibration files: all that was measured with one detector, in parts.

    {"format": "cp_env calibration 1", "detector": "fc7745fdf17a3d5d", "fusion": "mean",
     "previous_frame": {"source": "which scenes and attacks", "command": "what wrote this part",
                        "epsilon": {"1": 0.03, "2": 0.22}},
     "ego_agreement": …, "ego_similarity": …,
     "densities": {"source": …, "command": …, "n_vehicles": 5, "edges": …}}

A part that was not measured is not there.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

FORMAT = "cp_env calibration 1"
THRESHOLD_PARTS = ("previous_frame", "ego_agreement", "ego_similarity")
"""Thresholds by group size: of PRBI (a view and the view of the frame before), of PASAC, and of PASAC and ROBOSAC (a
view and the ego-only view of the same frame, by score maps or by boxes)."""
DENSITIES = "densities"
"""The part that `bayes` rests on."""
PARTS = (*THRESHOLD_PARTS, DENSITIES)
MAX_BYTES = 8 << 20
"""A calibration file is at most so long; one of five vehicles takes 45 kB."""


@dataclass(frozen=True)
class Calibration:
    """What was measured with one detector.

    Attributes:
        path: where it was read.
        detector: digest of the detector's weights.
        fusion: how the detector fuses.
        parts: by name, see `PARTS`.
    """

    path: Path
    detector: str
    fusion: str
    parts: Mapping[str, Mapping[str, Any]]

    def thresholds(self, part: str) -> dict[int, float]:
        """ε by group size, from one of `THRESHOLD_PARTS` that was measured."""
        return dict(self.parts[part]["epsilon"])

    def densities(self) -> Mapping[str, Any]:
        """What `defenders.bayes.histograms` reads; of a calibration that holds it."""
        return self.parts[DENSITIES]


def checked_thresholds(epsilon: Mapping[int, float]) -> dict[int, float]:
    """The thresholds by group size, as plain numbers.

    Raises:
        ValueError: sizes do not run from 1 without a gap, or an ε is not in [0, 1].
    """
    sizes = sorted(epsilon)
    if not sizes or sizes != list(range(1, len(sizes) + 1)):
        raise ValueError(f"thresholds must name every group size from 1 on, got sizes {sizes}; add the missing ones")
    for size in sizes:
        if not 0 <= epsilon[size] <= 1:
            raise ValueError(f"a threshold is a similarity in [0, 1], got {epsilon[size]} for size {size}")
    return {size: float(epsilon[size]) for size in sizes}


def read_calibration(path: Path) -> Calibration:
    """Read a calibration file.

    Raises:
        ValueError: the file is missing or is no calibration; the message names it.
    """
    stored = _stored(path)
    try:
        detector, fusion = stored["detector"], stored["fusion"]
        if not (isinstance(detector, str) and isinstance(fusion, str)):
            raise TypeError("detector and fusion are texts")
        parts = {name: dict(stored[name]) for name in PARTS if name in stored}
        for name in THRESHOLD_PARTS:
            if name in parts:
                sizes = {int(size): float(value) for size, value in parts[name]["epsilon"].items()}
                parts[name]["epsilon"] = checked_thresholds(sizes)
        return Calibration(path, detector, fusion, parts)
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise ValueError(f"broken calibration file {path}: {error!r}; write it again with cp-calibrate") from error


def write_part(path: Path, detector: str, fusion: str, part: str, content: Mapping[str, Any]) -> Calibration:
    """Put one part into the calibration file of a detector; the file appears whole or not at all.

    Args:
        path: of the file. It is made if it is not there. Parts of another detector are dropped.
        detector: digest of the detector's weights.
        fusion: how the detector fuses.
        part: one of `PARTS`.
        content: the part: with "source" and "command", and "epsilon" or what `bayes` reads.

    Returns:
        The calibration as it was read back.

    Raises:
        ValueError: an unknown part, or thresholds that cannot be.
    """
    if part not in PARTS:
        raise ValueError(f"unknown part {part!r} of a calibration; known: {', '.join(PARTS)}")
    held = dict(content)
    if part in THRESHOLD_PARTS:
        held["epsilon"] = {str(size): value for size, value in checked_thresholds(content["epsilon"]).items()}
    stored = _stored(path) if path.exists() else {}
    kept = {name: stored[name] for name in PARTS if name in stored} if stored.get("detector") == detector else {}
    parts = {name: {**kept, part: held}[name] for name in PARTS if name in {**kept, part: held}}
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_suffix(".part")
    draft.write_text(laid_out({"format": FORMAT, "detector": detector, "fusion": fusion, **parts}), encoding="utf-8")
    draft.replace(path)
    return read_calibration(path)


def laid_out(stored: Mapping[str, Any]) -> str:
    """The text of a file: lists of numbers on one line each, so that a change of one row shows as one."""
    text = json.dumps(stored, indent=1)
    return re.sub(r"\[[^\[\]{}]*\]", lambda found: re.sub(r"\s*\n\s*", " ", found[0]), text) + "\n"


def _stored(path: Path) -> dict[str, Any]:
    """The JSON object of a file of our format; ValueError naming the file otherwise."""
    try:
        if path.stat().st_size > MAX_BYTES:
            raise ValueError(f"it is longer than {MAX_BYTES} bytes")
        stored = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(stored, dict) or stored.get("format") != FORMAT:
            raise ValueError(f"its format is not {FORMAT!r}")
        return stored
    except FileNotFoundError as error:
        raise ValueError(f"no calibration file at {path}; write it with cp-calibrate --out {path}") from error
    except (OSError, RecursionError, UnicodeDecodeError, ValueError) as error:
        raise ValueError(f"broken calibration file {path}: {error!r}; write it again with cp-calibrate") from error
