"""Selection of a scene: twenty seconds of a longer drive, an ego, and the vehicles that stay in radio range of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from cp_env.scenes.sumo.network import Streets
from cp_env.scenes.sumo.traffic import Tracks

FRAMES = 100
RADIO = 50.0  # m: a connected vehicle never leaves this circle round the ego
SPREAD = 10.0  # m: the first four partners keep about this far from each other, to see different things
MOST, LEAST = 8, 5
_STRIDE = 15  # frames between the starts of windows tried


@dataclass(frozen=True)
class VehicleSelection:
    """Frames [start, start + FRAMES) and the track rows of the connected vehicles, the ego first."""

    value: float  # the higher the more promising
    start: int
    connected: Int[np.ndarray, " A"]


def candidates(
    tracks: Tracks, streets: Streets, rng: np.random.Generator, most: int, *, least: int = LEAST
) -> list[VehicleSelection]:
    """Up to `most` selections, the most promising first, from different windows; none without enough vehicles in range.

    A selection has at least `least` vehicles and at most `MOST`, or `least` if that is more.

    Good are: four partners at 20-35 m that spread out, some company in sight, an ego that drives about as far as the
    scene was drawn to see (from hardly at all to a whole street).
    """
    travel = rng.choice([0.0, 20.0, 35.0, 50.0], p=[0.15, 0.3, 0.3, 0.25])
    found: list[VehicleSelection] = []
    for start in range(0, len(tracks.pose) - FRAMES + 1, _STRIDE):
        window = tracks.pose[start : start + FRAMES : 9, :, :2]  # every ninth frame is enough to judge by
        here = np.flatnonzero(~np.isnan(tracks.pose[start : start + FRAMES, :, 0]).any(axis=0))
        place = window[:, here]
        gap = np.linalg.norm(place[:, :, None] - place[:, None], axis=-1)
        selections = []
        for ego in np.flatnonzero(_central(place, streets)).tolist():
            partners = _partners(gap, ego, least)
            if len(partners) >= least - 1:
                value = _value(place, gap, ego, partners, travel) + rng.normal(0, 0.3)
                selections.append(VehicleSelection(value, start, here[[ego, *partners[: max(MOST, least) - 1]]]))
        found += sorted(selections, key=lambda selected: -selected.value)[:2]
    return sorted(found, key=lambda selected: -selected.value)[:most]


def _central(place: Float[np.ndarray, "t v 2"], streets: Streets) -> Bool[np.ndarray, " v"]:
    return (np.linalg.norm(place - streets.centre, axis=-1) < streets.radius).all(axis=0)


def _partners(gap: Float[np.ndarray, "t v v"], ego: int, least: int) -> list[int]:
    """Four that spread out, nearest first, then the rest that stay in range, nearest first."""
    near = np.flatnonzero(gap[:, ego].max(axis=0) < RADIO - 1)
    if len(near) < least:  # the ego is among them
        return []
    pair = gap[:, near[:, None], near].mean(axis=0)
    order = np.argsort(pair[near == ego][0])  # the ego itself comes first
    chosen = [order[0]]
    for spread in (SPREAD, SPREAD / 2, 0.0):
        for k in order[1:]:
            if len(chosen) < LEAST and k not in chosen and pair[k, chosen].min() >= spread:
                chosen.append(k)
    rank = {k: r for r, k in enumerate(order)}
    chosen = sorted(chosen, key=rank.__getitem__) + [k for k in order if k not in chosen]
    return [int(row) for row in near[chosen[1:]]]


def _value(
    place: Float[np.ndarray, "t v 2"], gap: Float[np.ndarray, "t v v"], ego: int, partners: list[int], travel: float
) -> float:
    reach = gap[:, ego, partners[: LEAST - 1]].mean(axis=0)
    path = np.linalg.norm(np.diff(place[:, ego], axis=0), axis=-1).sum()
    company = (gap[:, ego] < 32).sum(axis=1).mean()
    off = np.clip(20 - reach, 0, None).sum() + np.clip(reach - 35, 0, None).sum()
    return float(-0.08 * off - 0.10 * abs(path - travel) + 0.15 * min(company, 12) + 0.2 * min(len(partners), MOST))
