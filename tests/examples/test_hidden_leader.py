"""The picture of a hidden leader: what it draws, and what it says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cp_env.driving import Drive, PseudoClosedLoop
from examples.reproduce.hidden_leader import Args, Episode, collision_frame, described, draw, from_ego
from tests.helpers.roads import boxes_at, driving, road, view_of


def episode(gap: float) -> Episode:
    """An ego that sees nothing, and a car that stands so far before its bumper; the other drive sees it."""
    scene = road([driving(0, 0, 8, 30), driving(gap + 4, 0, 0, 30)])
    loops = [PseudoClosedLoop([scene], [0]) for _ in range(2)]
    place = []
    for frame in range(30):
        place.append(loops[0].place(0))
        loops[0].step([view_of(boxes_at(), frame=frame)])
        loops[1].step([view_of(boxes_at((gap + 4, 0)), frame=frame)])
    return Episode(scene, 0, loops[0], loops[1], place, [boxes_at()] * 30, 0.1, [1, 2])


def test_the_collision_is_the_frame_in_which_the_boxes_first_overlap() -> None:
    """At about 8.1 m/s it takes 2.5 s, 12 to 13 frames, to use up 20 m."""
    crash = collision_frame(episode(20))
    assert crash in (12, 13)
    assert collision_frame(episode(500)) is None


def test_boxes_are_seen_from_the_ego() -> None:
    """The ego faces north: what is 5 m north of it is 5 m ahead."""
    seen = from_ego(np.array([[1.0, 7.0, 4.0, 2.0, np.pi / 2]]), np.array([1.0, 2.0, np.pi / 2]))
    assert seen[0] == pytest.approx([5, 0, 4, 2, 0])


def test_it_is_drawn_and_told(tmp_path: Path) -> None:
    assert draw(episode(20), Args(out=tmp_path / "a" / "b.png")).stat().st_size > 5_000
    drive = Drive(
        collided=True, hard_brakings=2, min_time_to_collision=0.0, mean_speed=3.0, hardest_braking=9.0, impact_speed=4.0
    )
    assert described("x", drive) == ("x: collides at 4.0 m/s, 2 hard brakings (hardest 9.0 m/s²), mean speed 3.0 m/s")
