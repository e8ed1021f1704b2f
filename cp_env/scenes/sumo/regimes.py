"""How the recorded scenes are drawn: which streets, how much traffic, and who is connected. Chance decides the rest.

A window of twenty seconds and an ego are drawn, each pair equally likely, among all that fit the scene's pace. Nothing
here knows what a sensor sees or what a detector finds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from cp_env.scenes.sumo.network import Streets
from cp_env.scenes.sumo.selection import FRAMES, SAMPLE, STANDS, STRIDE, VehicleSelection, partners, stands
from cp_env.scenes.sumo.traffic import DT, Tracks

FLOW = 5.0  # m/s: median speed, at least, of an ego that flows
HALT = 0.3  # m/s: who is slower stands
HALTS = 5.0  # s: so long, in all, an ego that waits stands
WAITS = 4  # of so many scenes of a split, the ego waits in the last

Pace = Literal["flows", "waits"]


@dataclass(frozen=True)
class Regime:
    """How scenes of one kind are drawn.

    streets: as `network.draw_streets` knows them.
    style: what stands along them, as `roadside.STYLES` knows it; also the scene's `kind`.
    crowd: least and most vehicles at once in the network; drawn.
    radio: m; a connected vehicle never leaves this circle round the ego.
    spread: m; the ego and the first four partners keep about this far from each other, where they can.
    least, most: connected vehicles, the ego among them.
    drives: m; every connected vehicle drives as far, at least, in a scene that flows.
    """

    streets: str
    style: str
    crowd: tuple[int, int]
    radio: float = 50.0
    spread: float = 16.0
    least: int = 5
    most: int = 8
    drives: float = 30.0


REGIMES = {
    "urban": Regime("urban", "urban", (110, 170)),
    "suburban": Regime("suburban", "suburban", (70, 110)),
    "intersection": Regime("intersection", "intersection", (40, 85)),
    "junction": Regime("junction", "intersection", (70, 110), spread=0.0, least=8),
}


def pace_of(number: int) -> Pace:
    """The pace of scene `number` of a split: of four scenes the ego flows in three and waits in one."""
    return "waits" if number % WAITS == WAITS - 1 else "flows"


def keeps(pace: Pace, speed: Float[np.ndarray, "t v"]) -> Bool[np.ndarray, " v"]:
    """Which vehicles keep a pace: half of the time at `FLOW` or more, or `HALTS` s at a stand; m/s, frame by frame."""
    if pace == "flows":
        return np.median(speed, axis=0) >= FLOW
    return (speed < HALT).sum(axis=0) * DT >= HALTS


def draw_selection(
    tracks: Tracks, streets: Streets, regime: Regime, pace: Pace, rng: np.random.Generator
) -> VehicleSelection | None:
    """A window, an ego that keeps the pace, and its partners; None where no vehicle has enough company.

    All connected vehicles drive at least `regime.drives` m in the window, or `selection.STANDS` m where the ego waits.
    The partners are those that stay within `regime.radio` of the ego: four that keep some distance from each other,
    nearest first, then the nearest.

    Args:
        tracks: the traffic; every vehicle may be connected.
        streets: the ego stays within `radius` of their `centre`.
        regime: how many are connected, and how near.
        pace: of the ego.
        rng: draws one of the pairs of a window and an ego.
    """
    driven = regime.drives if pace == "flows" else STANDS
    fitting: list[tuple[int, int]] = []  # start of the window, row of the ego
    for start in _starts(tracks):
        rows, place, gap = _moving(tracks, start, driven)
        central = (np.linalg.norm(place - streets.centre, axis=-1) < streets.radius).all(axis=0)
        company = (gap.max(axis=0) < regime.radio - 1).sum(axis=0)
        speed = np.linalg.norm(np.diff(tracks.pose[start : start + FRAMES, rows, :2], axis=0), axis=-1) / DT
        fits = central & (company >= regime.least) & keeps(pace, speed)
        fitting += [(start, int(row)) for row in rows[fits]]
    if not fitting:
        return None
    start, row = fitting[rng.integers(len(fitting))]
    rows, _, gap = _moving(tracks, start, driven)
    ego = int(np.searchsorted(rows, row))
    still = np.zeros(len(rows), dtype=bool)
    chosen = partners(gap, ego, regime.least, still, radio=regime.radio, spread=regime.spread)
    return VehicleSelection(0.0, start, rows[[ego, *chosen[: regime.most - 1]]])


def _starts(tracks: Tracks) -> range:
    return range(0, len(tracks.pose) - FRAMES + 1, STRIDE)


def _moving(
    tracks: Tracks, start: int, driven: float
) -> tuple[Int[np.ndarray, " v"], Float[np.ndarray, "t v 2"], Float[np.ndarray, "t v v"]]:
    """The vehicles there throughout a window that drive `driven` m: rows, places, distances between any two; m."""
    window = tracks.pose[start : start + FRAMES, :, :2]
    rows = np.flatnonzero(~np.isnan(window[..., 0]).any(axis=0))
    rows = rows[~stands(window[::SAMPLE, rows], driven)]
    place = window[::SAMPLE, rows]
    return rows, place, np.linalg.norm(place[:, :, None] - place[:, None], axis=-1)
