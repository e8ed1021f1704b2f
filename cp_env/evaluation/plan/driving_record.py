"""What a record holds of the ego's driving: critical vehicles, targeted success, severity, the pseudo-closed loop."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
from jaxtyping import Float

from cp_env.metrics.targeted import longest_streak


@dataclass(frozen=True, eq=False, kw_only=True)
class DrivingRecord:
    """The driving measures of one episode. Tuples run over its frames, grace frames included; flags are 0 or 1.

    See `cp_env.metrics.critical`, `severity` and `targeted`, and `cp_env.driving`.
    """

    critical: tuple[int, ...]  # critical vehicles
    critical_missed: tuple[int, ...]
    removable: tuple[int, ...]  # whether the nearest vehicle is found in the clean view
    removed: tuple[int, ...]  # and missing in the output
    spoofed: tuple[int, ...]
    decodes: tuple[int, ...]  # groups perceived
    belief: tuple[float, ...]  # the defender's, vehicle by vehicle in each frame; empty if it has none
    late_frames: int  # that took longer than the deadline
    mdr: float  # m/s²
    fsr: float  # m/s lost in a minute
    collided: bool
    hard_brakings: int
    hardest_braking: float  # m/s²
    impact_speed: float  # m/s
    min_time_to_collision: float | None  # s; None if the ego never closed in on a vehicle
    mean_speed: float  # m/s
    vehicles: tuple[int, ...] = ()  # true ones in range; empty where witnesses were not counted
    certified: tuple[int, ...] = ()  # of them, those that no attackers of this number can hide from a vote

    @classmethod
    def from_json(cls, data: Any, n_frames: int, n_maps: int) -> DrivingRecord:
        """The record that `asdict` gave.

        Args:
            data: what was stored.
            n_frames: of the episode.
            n_maps: vehicles that have a belief.

        Raises:
            ValueError, TypeError: it is none of such an episode.
        """
        if not isinstance(data, dict):
            raise ValueError("a driving record is an object with names and values")
        plain: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value for key, value in data.items()}
        made = cls(**plain)
        for one in fields(cls):
            value = getattr(made, one.name)
            if isinstance(value, tuple):
                kind = float if one.name == "belief" else int
                wanted = (0, n_frames * n_maps) if one.name == "belief" else (n_frames,)
                wanted = (0, n_frames) if one.name in ("vehicles", "certified") else wanted
                if len(value) not in wanted or any(type(item) is not kind for item in value):
                    raise ValueError(f"{one.name} of a driving record is of another length or type")
            elif type(value) not in _PLAIN[one.name]:
                raise ValueError(f"{one.name} of a driving record is of another type")
        made._check_ranges()
        return made

    def _check_ranges(self) -> None:
        """ValueError unless each value lies where such a value can lie."""
        found = zip(self.removable, self.removed, strict=True)
        missed = zip(self.critical, self.critical_missed, strict=True)
        least = self.min_time_to_collision
        lawful = (
            all(0 <= removed <= removable <= 1 for removable, removed in found)
            and all(0 <= missing <= there <= MAX_COUNT for there, missing in missed)
            and len(self.certified) == len(self.vehicles)
            and all(0 <= safe <= there <= MAX_COUNT for there, safe in zip(self.vehicles, self.certified, strict=False))
            and all(0 <= spoofed <= 1 for spoofed in self.spoofed)
            and all(0 <= count <= MAX_COUNT for count in (*self.decodes, self.late_frames, self.hard_brakings))
            and all(0 <= probability <= 1 for probability in self.belief)
            and all(0 <= v < math.inf for v in (self.mdr, self.fsr, self.hardest_braking, self.impact_speed))
            and 0 <= self.mean_speed < math.inf
            and (least is None or 0 <= least < math.inf)
        )
        if not lawful:
            raise ValueError("values of a driving record that no episode has")

    def to_json(self) -> dict[str, Any]:
        """All values, fit for JSON."""
        return asdict(self)

    def recall(self, grace: int) -> float | None:
        """Critical recall after the grace frames; None without a critical vehicle."""
        there = sum(self.critical[grace:])
        return 1 - sum(self.critical_missed[grace:]) / there if there else None

    def removal(self, grace: int) -> float | None:
        """Share of the frames with a removable target in which it is removed; None without such a frame."""
        there = sum(self.removable[grace:])
        return sum(self.removed[grace:]) / there if there else None

    def spoofing(self, grace: int) -> float | None:
        """Share of the frames in which a car is spoofed; None without a frame."""
        return float(np.mean(self.spoofed[grace:])) if len(self.spoofed) > grace else None

    def streak(self, grace: int) -> int:
        """The most consecutive frames in which the attack reached one of the two targets."""
        either = zip(self.removed[grace:], self.spoofed[grace:], strict=True)
        return longest_streak(removed or spoofed for removed, spoofed in either)

    def certified_recall(self, grace: int) -> float | None:
        """Certified recall after the grace frames; None without a vehicle, or where witnesses were not counted."""
        there = sum(self.vehicles[grace:])
        return sum(self.certified[grace:]) / there if there else None

    def beliefs(self, n_maps: int) -> Float[np.ndarray, "T N"]:
        """The defender's belief in each frame; no rows if it has none."""
        return np.array(self.belief, dtype=np.float64).reshape(-1, n_maps)


MAX_COUNT = 1 << 31
"""No count of a record is larger."""

_PLAIN: dict[str, tuple[type, ...]] = {
    "late_frames": (int,),
    "mdr": (float,),
    "fsr": (float,),
    "collided": (bool,),
    "hard_brakings": (int,),
    "hardest_braking": (float,),
    "impact_speed": (float,),
    "min_time_to_collision": (float, type(None)),
    "mean_speed": (float,),
}
"""Types of the values that are one for an episode."""


def believed(belief: Any, n_maps: int) -> Sequence[float]:
    """A defender's belief as a record holds it: one probability a vehicle, or nothing if it gives none."""
    try:
        array = np.asarray(belief, dtype=np.float64).ravel()
    except (TypeError, ValueError):
        return ()
    if array.size != n_maps or not np.isfinite(array).all():
        return ()
    return [round(float(value), 6) for value in array.clip(0.0, 1.0)]
