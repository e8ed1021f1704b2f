"""The pseudo-closed loop: the ego follows its recorded path behind what it perceives, while all others replay.

One number is simulated for each world: how far the ego has come on its recorded path. In each frame

* the ego perceives what it perceived at its recorded place. The output's boxes are moved into the world, and looked at
  from the place of the simulated ego. The detector is not asked again, so a simulated ego far from the recorded one
  sees only what was in range there. NAVSIM's first stage replays others in the same way;
* a box in its corridor is a leader. The output tells no speeds. So a true vehicle's box (a centre within 2 m) has that
  vehicle's speed, and a ghost moves as it did since the last frame, or stands if it is new: our choice;
* it accelerates as the Intelligent Driver Model does behind the leader that demands most. Its desired speed is the
  highest of the recording, at least 30 km/h;
* it waits where the recorded ego waits with nobody ahead, at red lights and for crossing traffic (see `road`). Vehicles
  it must see itself.

A collision is a rear-end one: an overlap with a true vehicle whose centre is ahead of the ego's, and that heads in the
same direction (within 60°) or stands. It ends the drive. A replayed vehicle cannot brake, so one that drives into the
ego from behind passes through it, and is left out from then on. So is one that begins to exist where the ego is: it
entered the recorded streets there, or came out of a jam, because the recorded ego was elsewhere. Conflicts with
crossing and oncoming vehicles do not count either: which of the two yields is not in a recording. None of this needs a
simulator.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from cp_env.driving.idm import CITY, DriverModel
from cp_env.driving.road import STANDING, Road
from cp_env.geometry.boxes import pairwise_iou
from cp_env.metrics.kinematics import velocities
from cp_env.metrics.severity import CLOSE
from cp_env.types import Scene, View

HARD = 4.0
"""Braking harder than this is hard; m/s²."""

REACH = 60.0
"""The ego looks so far along its path; m."""

SAME_WAY = np.pi / 3
"""Vehicles whose headings differ by less drive in one direction; rad."""

FASTEST = 25.0
"""A ghost that would have moved faster is another one; m/s."""


@dataclass(frozen=True, kw_only=True)
class Drive:
    """What became of one drive."""

    collided: bool
    hard_brakings: int  # how often it began to brake harder than 4 m/s²
    min_time_to_collision: float  # to a vehicle ahead, as for a collision; s, inf if it never closed in on one
    mean_speed: float  # m/s
    hardest_braking: float  # m/s²
    impact_speed: float  # closing speed of the collision along the path; m/s, 0 without one


@dataclass(frozen=True, eq=False)
class Moment:
    """The drives of all worlds in one frame."""

    along: Float[np.ndarray, " E"]  # of the ego's centre on its path; m
    speed: Float[np.ndarray, " E"]  # m/s
    acceleration: Float[np.ndarray, " E"]  # until the next frame; m/s²
    gap: Float[np.ndarray, " E"]  # to the nearest true vehicle ahead that drives the same way or stands; m


@dataclass(frozen=True, eq=False)
class Contacts:
    """The vehicles that an ego touches in one frame."""

    rows: Int[np.ndarray, " K"]  # of the scene
    ahead: Bool[np.ndarray, " K"]  # whether the centre is ahead of the ego's
    same_way: Bool[np.ndarray, " K"]  # whether it drives in the ego's direction, or stands
    appeared: Bool[np.ndarray, " K"]  # whether it was absent in the frame before
    moving: Float[np.ndarray, "K 2"]  # velocity; m/s
    heading: Float[np.ndarray, " 2"]  # of the ego; a unit vector


class PseudoClosedLoop:
    """E drives at once, each on the recorded path of its scene's ego.

    Args:
        scenes: of the worlds.
        starts: the frame of its scene in which each drive begins.
        driver: of every ego.
    """

    def __init__(self, scenes: Sequence[Scene], starts: Sequence[int], driver: DriverModel = CITY) -> None:
        self.driver = driver
        self._roads = [Road.of(scene, start) for scene, start in zip(scenes, starts, strict=True)]
        n = len(self._roads)
        first = [np.linalg.norm(velocities(road.scene, road.start)[road.ego]) for road in self._roads]
        self.along, self.speed = np.zeros(n), np.array(first, dtype=np.float64)
        self.history: list[Moment] = []
        self._frame = 0
        self._collided, self._impact = np.zeros(n, dtype=bool), np.zeros(n)
        self._nearest_ttc, self._running = np.full(n, np.inf), np.ones(n, dtype=bool)

    def step(self, outputs: Sequence[View]) -> None:
        """Drive on until the next frame, behind the outputs of this one.

        A drive that has come to the last frame of its scene, or has collided, stays where it is.
        """
        worlds = range(len(self._roads))
        demand = np.array([self._acceleration(e, outputs[e]) for e in worlds])
        gap = np.array([self._observe(e) for e in worlds])
        last = np.array([road.start + self._frame + 1 >= road.scene.n_frames for road in self._roads])
        self._running &= ~last & ~self._collided
        acceleration = np.where(self._running, demand, 0.0)
        self.history.append(Moment(self.along.copy(), self.speed.copy(), acceleration, gap))
        dt = np.array([road.scene.dt for road in self._roads])
        faster = np.maximum(self.speed + acceleration * dt, 0.0)
        self.along = self.along + np.where(self._running, (self.speed + faster) / 2 * dt, 0.0)
        self.speed = np.where(self._running, faster, self.speed)
        self._frame += 1
        self._move_others()
        for e in np.flatnonzero(self._running):
            self._check_collision(int(e))

    def drives(self) -> list[Drive]:
        """What has become of every drive so far."""
        braking = -self._series("acceleration")
        hard = braking > HARD
        begins = hard & ~np.concatenate([np.zeros((1, len(self._roads)), dtype=bool), hard[:-1]])[: len(hard)]
        seconds = np.array([road.scene.dt for road in self._roads]) * max(len(self.history), 1)
        return [
            Drive(
                collided=bool(self._collided[e]),
                hard_brakings=int(begins[:, e].sum()),
                min_time_to_collision=float(self._nearest_ttc[e]),
                mean_speed=float(self.along[e] / seconds[e]),
                hardest_braking=max(0.0, float(braking[:, e].max(initial=0.0))),
                impact_speed=float(self._impact[e]),
            )
            for e in range(len(self._roads))
        ]

    def place(self, world: int) -> Float[np.ndarray, " 3"]:
        """Where the simulated ego is: x, y, heading in the world frame; m, rad."""
        return self._roads[world].path.place(float(self.along[world]))

    def _move_others(self) -> None:
        """Bring the traffic to the next frame; here it replays."""

    def _series(self, name: str) -> Float[np.ndarray, "F E"]:
        rows = [getattr(moment, name) for moment in self.history]
        return np.array(rows, dtype=np.float64).reshape(len(rows), len(self._roads))

    def _acceleration(self, e: int, output: View) -> float:
        """What the driver does about the boxes in its corridor, and where the recorded ego waits."""
        road, along, speed = self._roads[e], float(self.along[e]), float(self.speed[e])
        boxes = output.seen.boxes.astype(np.float64)
        boxes[:, :2] += output.origin
        moving = self._velocities(road, boxes)
        corridor = road.path.ahead(along, REACH, road.front)
        gaps, heading = corridor.gaps(boxes)
        inside = np.isfinite(gaps) & np.isfinite(moving).all(axis=1)
        leads = np.append(gaps[inside], self._stops(road, along))
        closing = np.append(speed - (moving * heading).sum(-1)[inside], np.full(len(leads) - int(inside.sum()), speed))
        leads, closing = np.append(leads, np.inf), np.append(closing, 0.0)  # the free road
        n = len(leads)
        return float(self.driver(np.full(n, speed), np.full(n, road.desired), leads, closing).min())

    def _stops(self, road: Road, along: float) -> list[float]:
        """Gaps to the lines at which the ego has to wait now. One that was passed is passed."""
        now = road.start + self._frame
        gaps = [wait.along - along + self.driver.standstill for wait in road.waits if wait.first <= now <= wait.last]
        return [gap for gap in gaps if gap > 0]

    def _velocities(self, road: Road, boxes: Float[np.ndarray, "B 5"]) -> Float[np.ndarray, "B 2"]:
        """Of each box in the world: the true vehicle's within 2 m, or the ghost's own since the last frame; m/s.

        NaN for the box of a vehicle that is left out.
        """
        frame = self._now(road)
        place = road.scene.pose[frame, :, :2]
        velocity, last = np.zeros((len(boxes), 2)), road.ghosts
        distance = np.linalg.norm(boxes[:, None, :2] - np.nan_to_num(place, nan=np.inf), axis=-1)
        true = distance.min(axis=1, initial=np.inf) <= CLOSE
        velocity[true] = velocities(road.scene, frame)[distance[true].argmin(axis=1)]
        velocity[np.isin(distance.argmin(axis=1), list(road.left_out)) & true] = np.nan
        road.ghosts = boxes[~true, :2]
        if len(road.ghosts) and len(last):
            step = road.ghosts[:, None] - last
            step = step[np.arange(len(step)), np.linalg.norm(step, axis=-1).argmin(axis=1)]
            followed = np.linalg.norm(step, axis=-1) <= FASTEST * road.scene.dt
            velocity[~true] = np.where(followed[:, None], step / road.scene.dt, 0.0)
        return velocity

    def _now(self, road: Road) -> int:
        """The scene's frame."""
        return min(road.start + self._frame, road.scene.n_frames - 1)

    def _observe(self, e: int) -> float:
        """Keep the least time to collision; returns the gap to the nearest vehicle ahead, m."""
        road = self._roads[e]
        frame, rows = self._now(road), road.rows(self._now(road))
        boxes, moving = road.boxes(frame, rows), velocities(road.scene, frame)[rows]
        gaps, heading = road.path.ahead(float(self.along[e]), REACH, road.front).gaps(boxes)
        gaps = np.where(_same_way(boxes, moving, float(self.place(e)[2])), gaps, np.inf)
        closing = float(self.speed[e]) - (moving * heading).sum(-1)
        ahead = np.isfinite(gaps) & (closing > 0)
        if self._running[e] and ahead.any():
            self._nearest_ttc[e] = min(self._nearest_ttc[e], float((gaps[ahead] / closing[ahead]).min()))
        return float(gaps.min(initial=np.inf))

    def _contacts(self, e: int) -> Contacts:
        """The vehicles that the ego touches now."""
        road, place = self._roads[e], self.place(e)
        frame = self._now(road)
        rows = road.rows(frame)
        ego = np.array([[*place[:2], *road.scene.size[road.ego, :2], place[2]]])
        boxes, heading = road.boxes(frame, rows), np.array([np.cos(place[2]), np.sin(place[2])])
        touched = pairwise_iou(ego, boxes)[0] > 0
        ahead = (boxes[:, :2] - place[:2]) @ heading > 0
        moving = velocities(road.scene, frame)[rows]
        same_way = _same_way(boxes, moving, float(place[2]))
        appeared = np.isnan(road.scene.pose[frame - 1, rows, 0])
        return Contacts(rows[touched], ahead[touched], same_way[touched], appeared[touched], moving[touched], heading)

    def _check_collision(self, e: int) -> None:
        road, touched = self._roads[e], self._contacts(e)
        hit = touched.ahead & touched.same_way & ~touched.appeared
        road.left_out |= set(touched.rows[~touched.ahead | touched.appeared].tolist())
        if hit.any():
            self._collided[e] = True
            self._impact[e] = max(float(self.speed[e]) - float((touched.moving[hit] @ touched.heading).min()), 0.0)
            self._nearest_ttc[e], self.speed[e] = 0.0, 0.0


def _same_way(
    boxes: Float[np.ndarray, "L 5"], moving: Float[np.ndarray, "L 2"], heading: float
) -> Bool[np.ndarray, " L"]:
    """Whether vehicles drive in that direction, or stand."""
    along: Bool[np.ndarray, " L"] = np.cos(boxes[:, 4] - heading) > np.cos(SAME_WAY)
    return along | (np.linalg.norm(moving, axis=1) < STANDING)
