"""The closed loop on roads built by hand: followers that brake or do not, lines, and ends."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from cp_env.driving import CITY
from cp_env.driving.reactive import BEFORE, ClosedLoop
from cp_env.metrics.corridor import Path
from cp_env.types import Scene
from tests.helpers.roads import boxes_at, road, view_of

DT = 0.2
LENGTH = 4.0
FRAMES = 80


class Lane:
    """A straight lane: the ego, and others that are told each frame where the ego is.

    Args:
        others: x and speed of each; m, m/s.
        react: acceleration of another from (its x, its speed, the ego's x, the ego's speed); m/s².
        lines: x of lines at which the ego has to wait, and the frame from which on it need not.
    """

    def __init__(
        self,
        others: list[tuple[float, float]],
        react: Callable[[float, float, float, float], float] = lambda x, v, ego, speed: 0.0,
        lines: dict[float, int] | None = None,
        speed: float = 8.0,
    ) -> None:
        self.frame, self.fastest, self.ended = 0, 0.0, False
        self.react, self.lines = react, lines or {}
        self.cars = np.array([[0.0, speed], *others])
        self.seen = [self.cars.copy()]
        self.scene = self._snapshot()
        self.path = Path.recorded(road([[(float(x), 0.0, 0.0) for x in range(300)]]), 0, 0)

    def _snapshot(self) -> Scene:
        """Frames so far, then straight on."""
        to_come = [self.cars + [[k * DT * v, 0.0] for v in self.cars[:, 1]] for k in range(1, FRAMES - self.frame)]
        return road([[(x, 0.0, 0.0) for x in row] for row in np.array([*self.seen, *to_come])[:, :, 0].T.tolist()])

    def stop_lines(self) -> list[float]:
        front = self.cars[0, 0] + LENGTH / 2
        return [x - front for x, until in self.lines.items() if x >= front and self.frame < until]

    def step(self, place: np.ndarray, speed: float) -> None:
        ego = self.cars[0].copy()
        for car in self.cars[1:]:
            car[1] = max(car[1] + DT * self.react(car[0], car[1], ego[0], ego[1]), 0.0)
            car[0] += DT * car[1]
        self.cars[0] = place[0], speed
        self.seen.append(self.cars.copy())
        self.frame += 1
        self.ended = self.frame + 1 >= FRAMES
        self.scene = self._snapshot()


def follow(x: float, v: float, ego: float, speed: float) -> float:
    """A driver behind the ego who sees it."""
    speeds, desired, gap, closing = (np.array([value]) for value in (v, 8.0, ego - x - LENGTH, v - speed))
    return float(CITY(speeds, desired, gap, closing)[0])


def drive(lane: Lane, *, sees: bool = True) -> ClosedLoop:
    loop = ClosedLoop(lane)
    while not loop.over:
        there = [(float(x), 0.0) for x, _ in lane.cars[1:] if x > lane.cars[0, 0]]
        loop.step([view_of(boxes_at(*there) if sees else boxes_at(), frame=lane.frame)])
    return loop


def test_who_sees_the_standing_car_stops_and_the_one_behind_stops_too() -> None:
    """The replayed follower of the pseudo-closed loop would drive through the ego. This one brakes."""
    lane = Lane([(44.0, 0.0), (-20.0, 8.0)], lambda x, v, ego, speed: follow(x, v, ego, speed) if v else 0.0)
    loop = drive(lane)
    (end,) = loop.drives()
    assert not end.collided and end.hard_brakings == 0 and loop.struck == 0
    assert 36 < loop.along[0] < 40 and loop.speed[0] < 0.5
    assert lane.cars[2, 0] < loop.along[0] - LENGTH


def test_who_does_not_see_it_collides_and_the_drive_is_over() -> None:
    loop = drive(Lane([(44.0, 0.0)]), sees=False)
    (end,) = loop.drives()
    assert end.collided and end.min_time_to_collision == 0.0 and 8 <= end.impact_speed < 30 / 3.6
    assert loop.over and len(loop.history) < FRAMES / 2 and loop.struck == loop.crossed == 0


def test_who_brakes_for_nothing_is_struck_by_a_follower_that_keeps_its_speed() -> None:
    lane = Lane([(-14.0, 8.0)])
    loop = ClosedLoop(lane)
    while not loop.over:
        loop.step([view_of(boxes_at((lane.cars[0, 0] + 7.0, 0.0)), frame=lane.frame)])
    (end,) = loop.drives()
    assert loop.struck == 1 and not end.collided and loop.crossed == 0
    assert end.hard_brakings >= 1


def test_it_waits_before_a_line_until_it_may_go() -> None:
    """Its front stays about a metre before x = 40 until frame 60; then it drives on."""
    lane = Lane([], lines={40.0: 60})
    loop = ClosedLoop(lane)
    fronts = []
    while not loop.over:
        loop.step([view_of(boxes_at(), frame=lane.frame)])
        fronts.append(float(loop.along[0]) + LENGTH / 2)
    assert fronts[58] == pytest.approx(40 - BEFORE, abs=0.5) and max(fronts[:60]) < 40
    assert fronts[-1] > 42
    assert loop.drives()[0].hard_brakings == 0


def test_the_drive_ends_with_the_traffic() -> None:
    lane = Lane([])
    loop = drive(lane)
    assert loop.over and len(loop.history) == FRAMES - 1
    loop.step([view_of(boxes_at())])
    assert lane.frame == FRAMES - 1, "nobody is moved any more"
    assert loop.drives()[0].mean_speed == pytest.approx(loop.along[0] / (FRAMES * DT))


def test_alone_it_drives_as_in_the_pseudo_closed_loop() -> None:
    """1 − (8 / 8.33)⁴ = 0.1507 m/s² on a free road, as worked by hand there."""
    lane = Lane([])
    loop = ClosedLoop(lane)
    loop.step([view_of(boxes_at())])
    assert loop.speed[0] == pytest.approx(8.03013, abs=1e-5)
    assert lane.cars[0] == pytest.approx([1.603013, 8.03013], abs=1e-5)
