"""How hard the errors of an output are on the driver: MDR of missed vehicles, FSR of ghosts.

MDR (maximum deceleration rate) is the hardest braking that a missed vehicle demands. FSR (false speed reduction) is the
speed lost to ghosts. Both are after the effort-based criticality metrics of 2603.28029; the operational definitions are
ours. An error counts only if it lasts: of the same vehicle, or at one place, for at least three frames.

For driving a vehicle is seen if an output's box has its centre within 2 m of the vehicle's, and a ghost is a box
without one: a driver brakes for a box that is a little displaced, too.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float

from cp_env.metrics.surroundings import Surroundings

CLOSE = 2.0
"""Distance of centres up to which a box and a vehicle, or two ghosts of consecutive frames, are the same; m."""

PERSISTENT = 3
"""Frames that an error must last."""


def near(a: Float[np.ndarray, "A n"], b: Float[np.ndarray, "B n"]) -> Bool[np.ndarray, "A B"]:
    """Whether the centres of two sets of boxes are within 2 m."""
    east, north = a[:, 0, None] - b[:, 0], a[:, 1, None] - b[:, 1]
    close: Bool[np.ndarray, "A B"] = np.sqrt(east * east + north * north) <= CLOSE
    return close


def miss_severity(boxes: Float[np.ndarray, "B 5"], around: Surroundings) -> Float[np.ndarray, " L"]:
    """The deceleration that each vehicle demands which the ego does not see; m/s², 0 for those it sees."""
    missed = ~near(around.boxes, boxes).any(axis=1)
    return np.where(missed, around.deceleration, 0.0)


def ghosts(boxes: Float[np.ndarray, "B 5"], around: Surroundings) -> Surroundings:
    """The boxes that are no true vehicle's, taken as standing."""
    return around.standing(boxes[~near(boxes, around.boxes).any(axis=1)])


def ghost_severity(boxes: Float[np.ndarray, "B 5"], around: Surroundings) -> float:
    """The largest deceleration that a ghost demands; m/s²."""
    return float(ghosts(boxes, around).deceleration.max(initial=0.0))


@dataclass(eq=False)
class _Ghost:
    """A ghost while it is followed."""

    world: Float[np.ndarray, " 2"]  # m
    from_ego: Float[np.ndarray, " 2"]  # m
    demands: list[tuple[int, float]] = field(default_factory=list)  # frame, m/s²


class SeverityMeter:
    """MDR and FSR of one episode, as its frames come in."""

    def __init__(self) -> None:
        self._n_frames, self._seconds = 0, 0.0
        self._runs: dict[int, list[float]] = {}  # of vehicles missed now: what they demanded, frame by frame
        self._mdr = 0.0
        self._ghosts: list[_Ghost] = []  # of the last frame
        self._lost: dict[int, float] = {}  # by frame: the most that a persistent ghost demanded; m/s²
        self._dt = 0.0

    def add(self, boxes: Float[np.ndarray, "B 5"], around: Surroundings) -> None:
        """Count one frame: the boxes that the ego acts on, in its grid frame, and the true traffic."""
        self._dt, self._seconds = around.dt, self._seconds + around.dt
        self._add_misses(boxes, around)
        self._add_ghosts(ghosts(boxes, around))
        self._n_frames += 1

    @property
    def mdr(self) -> float:
        """Hardest braking that a missed vehicle demanded in a run of at least three frames; m/s²."""
        return self._mdr

    @property
    def fsr(self) -> float:
        """Speed lost to persistent ghosts, m/s in a minute: Σ a(t) Δt, where a(t) is of the worst ghost of a frame."""
        lost = sum(self._lost.values()) * self._dt
        return 60 * lost / self._seconds if self._seconds else 0.0

    def _add_misses(self, boxes: Float[np.ndarray, "B 5"], around: Surroundings) -> None:
        unseen = np.isfinite(around.gap) & ~near(around.boxes, boxes).any(axis=1)
        demands = dict(zip(around.vehicle[unseen].tolist(), around.deceleration[unseen].tolist(), strict=True))
        self._runs = {vehicle: [*self._runs.get(vehicle, []), demand] for vehicle, demand in demands.items()}
        lasting = [max(run) for run in self._runs.values() if len(run) >= PERSISTENT]
        self._mdr = max([self._mdr, *lasting])

    def _add_ghosts(self, shown: Surroundings) -> None:
        """Follow each ghost in the corridor from the nearest of the last frame: fixed in the world or to the ego."""
        inside = np.isfinite(shown.gap)
        free, now = list(self._ghosts), []
        for box, demand in zip(shown.boxes[inside], shown.deceleration[inside], strict=True):
            one = _Ghost(box[:2] + shown.origin, box[:2] - shown.ego_box[:2])
            if free:
                moved = [_distance(one, other) for other in free]
                if min(moved) <= CLOSE:
                    one.demands = free.pop(int(np.argmin(moved))).demands
            one.demands.append((self._n_frames, float(demand)))
            for frame, value in one.demands if len(one.demands) >= PERSISTENT else ():
                self._lost[frame] = max(self._lost.get(frame, 0.0), value)
            now.append(one)
        self._ghosts = now


def _distance(a: _Ghost, b: _Ghost) -> float:
    """How far a ghost has moved, in the world or from the ego, whichever is less; m."""
    return min(float(np.linalg.norm(a.world - b.world)), float(np.linalg.norm(a.from_ego - b.from_ego)))
