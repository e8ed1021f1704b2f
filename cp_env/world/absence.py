"""Absent vehicles: one may appear late or drop out, and then sends nothing."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import cache
from typing import Any

from defenders.registry import shown

Absences = Mapping[int, Collection[int]]
"""From the number of a vehicle to the frames of the episode in which its map is not there."""


def checked(absent: Any, n_maps: int) -> Absences:
    """The absences, if they name vehicles 1 … n_maps - 1 and frames; else ValueError. The ego is always there."""
    if not isinstance(absent, Mapping) or not all(isinstance(frames, Collection) for frames in absent.values()):
        raise ValueError(
            f'"absent" maps vehicles to frames without them, as in {{3: range(10, 20)}}, not {shown(absent)}'
        )
    if wrong := [vehicle for vehicle in absent if vehicle not in range(1, n_maps)]:
        raise ValueError(f'"absent" must name vehicles 1..{n_maps - 1} (the ego is always there), not {shown(wrong)}')
    return dict(absent)


def present(absent: Absences, n_maps: int, frame: int) -> frozenset[int]:
    """The vehicles that send a map in a frame of the episode."""
    return frozenset(i for i in range(n_maps) if frame not in absent.get(i, ())) if absent else _all(n_maps)


@cache
def _all(n_maps: int) -> frozenset[int]:
    return frozenset(range(n_maps))
