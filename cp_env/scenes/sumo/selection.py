"""Selection of a scene: twenty seconds of a longer drive, an ego, and the vehicles that stay in radio range of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from cp_env.scenes.sumo.network import Streets
from cp_env.scenes.sumo.traffic import DT, Tracks

FRAMES = 100
RADIO = 50.0  # m: a connected vehicle never leaves this circle round the ego
SPREAD = 10.0  # m: the first four partners keep about this far from each other, to see different things
MOST, LEAST = 8, 5
STANDS = 10.0  # m: who drives less in the twenty seconds stands for the whole scene
STRIDE = 15  # frames between the starts of windows tried
SAMPLE = 9  # frames: every ninth is enough to judge by
_STILL = 1.0  # of its value a selection loses for each of the first five that stands
_DRIVES = 2.0  # of value it gains, where that counts, if the first five drive all the time
_PACE = 0.5  # m/s: who is slower waits


Standing = Literal["never", "last"]


@dataclass(frozen=True)
class VehicleSelection:
    """Frames [start, start + FRAMES) and the track rows of the connected vehicles, the ego first."""

    value: float  # the higher the more promising
    start: int
    connected: Int[np.ndarray, " A"]


def candidates(
    tracks: Tracks,
    streets: Streets,
    rng: np.random.Generator,
    most: int,
    *,
    least: int = LEAST,
    standing: Standing = "never",
) -> list[VehicleSelection]:
    """Up to `most` selections, the most promising first, from different windows; none without enough vehicles in range.

    A selection has at least `least` vehicles and at most `MOST`, or `least` if that is more.

    Good are: four partners at 20-35 m that spread out, some company in sight, an ego that drives about as far as the
    scene was drawn to see (from hardly at all to a whole street).

    Args:
        tracks: vehicles that may be connected.
        streets: the ego stays within `radius` of their `centre`.
        rng: draws how far the ego should drive, and a little of each selection's value.
        most: selections wanted.
        least: connected vehicles wanted.
        standing: whether vehicles that drive less than `STANDS` m in the window are chosen: "never", or "last" (only up
            to `least`, where too few move). Windows are preferred in which the first five wait less.

    Returns:
        The selections; at most two of each window.
    """
    travel = rng.choice([0.0, 20.0, 35.0, 50.0], p=[0.15, 0.3, 0.3, 0.25])
    found: list[VehicleSelection] = []
    for start in range(0, len(tracks.pose) - FRAMES + 1, STRIDE):
        window = tracks.pose[start : start + FRAMES : SAMPLE, :, :2]
        here = np.flatnonzero(~np.isnan(tracks.pose[start : start + FRAMES, :, 0]).any(axis=0))
        still = stands(window[:, here])
        if standing == "never":
            here, still = here[~still], still[~still]
        place = window[:, here]
        gap = np.linalg.norm(place[:, :, None] - place[:, None], axis=-1)
        selections = []
        for ego in np.flatnonzero(_central(place, streets)).tolist():
            others = partners(gap, ego, least, still)
            if len(others) >= least - 1:
                value = _value(place, gap, ego, others, travel) + rng.normal(0, 0.3)
                first = [ego, *others[: LEAST - 1]]
                value += _DRIVES * _driving(place[:, first]) - _STILL * int(still[first].sum())
                taken = min(max(MOST, least), max(least, 1 + int((~still[others]).sum()))) - 1
                selections.append(VehicleSelection(value, start, here[[ego, *others[:taken]]]))
        found += sorted(selections, key=lambda selected: -selected.value)[:2]
    return sorted(found, key=lambda selected: -selected.value)[:most]


def stands(place: Float[np.ndarray, "t v 2"], least: float = STANDS) -> Bool[np.ndarray, " v"]:
    """Which vehicles drive less than `least` m on the way through these places."""
    driven: Float[np.ndarray, " v"] = np.linalg.norm(np.diff(place, axis=0), axis=-1).sum(axis=0)
    return driven < least


def _driving(place: Float[np.ndarray, "t v 2"]) -> float:
    """The share of the time, over all vehicles, in which one drives."""
    return float((np.linalg.norm(np.diff(place, axis=0), axis=-1) > _PACE * SAMPLE * DT).mean())


def _central(place: Float[np.ndarray, "t v 2"], streets: Streets) -> Bool[np.ndarray, " v"]:
    return (np.linalg.norm(place - streets.centre, axis=-1) < streets.radius).all(axis=0)


def partners(
    gap: Float[np.ndarray, "t v v"],
    ego: int,
    least: int,
    still: Bool[np.ndarray, " v"],
    *,
    radio: float = RADIO,
    spread: float = SPREAD,
) -> list[int]:
    """Four that spread out, nearest first, then the rest that stay in range, nearest first; `still` ones come last.

    Args:
        gap: m between any two vehicles.
        ego: whose partners they are; a column.
        least: connected vehicles wanted; the list is empty where there are fewer.
        still: which vehicles stand.
        radio: m; the range.
        spread: m; the first four and the ego keep about this far from each other, where they can.
    """
    near = np.flatnonzero(gap[:, ego].max(axis=0) < radio - 1)
    if len(near) < least:  # the ego is among them
        return []
    pair = gap[:, near[:, None], near].mean(axis=0)
    order = np.argsort(pair[near == ego][0])  # the ego itself comes first
    chosen = [order[0]]
    for last in (False, True):
        for apart in (spread, spread / 2, 0.0):
            for k in order[1:]:
                if (
                    still[near[k]] == last
                    and len(chosen) < LEAST
                    and k not in chosen
                    and pair[k, chosen].min() >= apart
                ):
                    chosen.append(k)
    rank = {k: (still[near[k]], r) for r, k in enumerate(order)}
    rank[order[0]] = (False, 0)
    chosen = sorted(chosen, key=rank.__getitem__) + sorted((k for k in order if k not in chosen), key=rank.__getitem__)
    return [int(row) for row in near[chosen[1:]]]


def _value(
    place: Float[np.ndarray, "t v 2"], gap: Float[np.ndarray, "t v v"], ego: int, partners: list[int], travel: float
) -> float:
    reach = gap[:, ego, partners[: LEAST - 1]].mean(axis=0)
    path = np.linalg.norm(np.diff(place[:, ego], axis=0), axis=-1).sum()
    company = (gap[:, ego] < 32).sum(axis=1).mean()
    off = np.clip(20 - reach, 0, None).sum() + np.clip(reach - 35, 0, None).sum()
    return float(-0.08 * off - 0.10 * abs(path - travel) + 0.15 * min(company, 12) + 0.2 * min(len(partners), MOST))
