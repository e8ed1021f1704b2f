"""The pseudo-closed loop: roads built by hand, and the town with perfect and with no perception."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from cp_env.driving import Drive, PseudoClosedLoop
from cp_env.geometry.planar import grid_origin
from cp_env.metrics.ground_truth import truth_boxes
from cp_env.scenes import open_source
from cp_env.types import Scene, View
from tests.helpers.roads import boxes_at, driving, road, view_of

FRAMES = 60
Perceive = Callable[[Scene, int], np.ndarray]


def truth(scene: Scene, frame: int) -> np.ndarray:
    return truth_boxes(scene, frame, 0, 60.0).astype(np.float64)


def nothing(scene: Scene, frame: int) -> np.ndarray:
    return boxes_at()


def views(scene: Scene, perceive: Perceive, frame: int) -> View:
    origin = grid_origin(scene.pose[frame, int(scene.connected[0]), :2])
    return view_of(perceive(scene, frame), origin, frame)


def drive(scene: Scene, perceive: Perceive) -> tuple[Drive, PseudoClosedLoop]:
    loop = PseudoClosedLoop([scene], [0])
    for frame in range(scene.n_frames):
        loop.step([views(scene, perceive, frame)])
    return loop.drives()[0], loop


def queue(gap: float = 40.0, frames: int = FRAMES) -> Scene:
    """An ego at 8 m/s and a standing car; the recorded ego has driven through it, which replay allows."""
    return road([driving(0, 0, 8, frames), driving(gap + 4, 0, 0, frames)])


def test_who_sees_the_standing_car_stops_before_it() -> None:
    seen, loop = drive(queue(), truth)
    assert not seen.collided and seen.hard_brakings == 0 and seen.impact_speed == 0.0
    assert loop.speed[0] < 0.5
    assert 36 < loop.along[0] < 40
    assert seen.mean_speed == pytest.approx(loop.along[0] / (FRAMES * 0.2))


def test_who_does_not_see_it_drives_into_it() -> None:
    """No leader: the ego keeps its 8 to 8.33 m/s, and the drive ends at the first overlap, after 40 m."""
    blind, loop = drive(queue(), nothing)
    assert blind.collided and blind.min_time_to_collision == 0.0
    assert 8 <= blind.impact_speed < 30 / 3.6
    assert 40 <= loop.along[0] < 40 + 0.2 * 8.4
    moments = loop.history[-2:]
    assert moments[0].along == moments[1].along


def test_who_sees_it_late_brakes_hard() -> None:
    late, _ = drive(queue(), lambda scene, frame: truth(scene, frame) if frame > 20 else nothing(scene, frame))
    assert not late.collided
    assert late.hard_brakings >= 1 and late.hardest_braking > 4


def test_a_ghost_that_keeps_ten_metres_ahead_costs_speed() -> None:
    free = road([driving(0, 0, 8, FRAMES)])
    phantom, _ = drive(free, lambda scene, frame: boxes_at((14 + scene.pose[frame, 0, 0] % 2, 0)))
    calm, _ = drive(free, nothing)
    assert calm.mean_speed > 7.9 and calm.min_time_to_collision == np.inf
    assert phantom.mean_speed < calm.mean_speed - 0.5


def test_a_step_by_hand() -> None:
    """1 − (8 / 8.33)⁴ = 0.1507 m/s² on a free road: 8.0301 m/s after 0.2 s, 1.60301 m at the mean speed."""
    loop = PseudoClosedLoop([road([driving(0, 0, 8, 3)])], [0])
    loop.step([view_of(boxes_at())])
    assert loop.history[0].acceleration[0] == pytest.approx(1 - (8 / (30 / 3.6)) ** 4)
    assert loop.speed[0] == pytest.approx(8.03013, abs=1e-5)
    assert loop.along[0] == pytest.approx(1.603013, abs=1e-6)


@pytest.mark.parametrize("speed", [8.0, 0.0])
def test_a_ghost_has_the_speed_of_its_own_boxes(speed: float) -> None:
    """It is at x = 25.6 m in the second frame; new in the first, it stands there. The model's terms are written out."""
    loop = PseudoClosedLoop([road([driving(0, 0, 8, 3)])], [0])
    for frame in range(2):
        loop.step([view_of(boxes_at((25.6 + speed * 0.2 * (frame - 1), 0)), frame=frame)])
    second = loop.history[1]
    v, gap = float(second.speed[0]), 25.6 - float(second.along[0]) - 4
    wanted = 2 + v + v * (v - speed) / (2 * np.sqrt(1.5))
    assert second.acceleration[0] == pytest.approx(1 - (v / (30 / 3.6)) ** 4 - (wanted / gap) ** 2)


def test_a_leader_of_the_same_speed_is_followed() -> None:
    followed, loop = drive(road([driving(0, 0, 8, FRAMES), driving(24, 0, 8, FRAMES)]), truth)
    assert not followed.collided and followed.hard_brakings == 0
    assert 7 < loop.speed[0] < 30 / 3.6


def test_a_vehicle_that_drives_into_the_ego_from_behind_is_no_collision_and_no_leader() -> None:
    """The ego stops behind a standing car; a replayed one comes up from behind at 8 m/s, and through both."""
    scene = road([driving(0, 0, 8, FRAMES), driving(44, 0, 0, FRAMES), driving(-40, 0, 8, FRAMES)])
    passed, loop = drive(scene, truth)
    assert not passed.collided
    assert loop.along[0] > 36


@pytest.mark.parametrize("absent", [0, 20])
def test_a_vehicle_that_begins_to_exist_where_the_ego_is_is_no_collision(absent: int) -> None:
    """A car stands at x = 34 m from frame `absent` on. After 20 frames of 1.6 m the ego, which is blind, is there."""
    nowhere = (np.nan, np.nan, np.nan)
    stands = [nowhere if frame < absent else (34.0, 0.0, 0.0) for frame in range(FRAMES)]
    blind, loop = drive(road([driving(0, 0, 8, FRAMES), stands]), nothing)
    assert blind.collided == (absent == 0)
    assert (loop.along[0] > 80) == (absent > 0), "it drives on through what was not there"


def test_crossing_traffic_is_no_collision() -> None:
    """It crosses the ego's path just when it comes."""
    scene = road([driving(0, 0, 8, FRAMES), driving(24, -24, 8, FRAMES, yaw=np.pi / 2)])
    assert not drive(scene, nothing)[0].collided


def test_it_waits_at_a_red_light_and_drives_on() -> None:
    stands = [(float(x), 0.0, 0.0) for x in range(31)] + [(30.0, 0.0, 0.0)] * 20 + [(30.0 + x, 0, 0) for x in range(20)]
    scene = road([stands])
    loop = PseudoClosedLoop([scene], [0])
    for frame in range(scene.n_frames):
        loop.step([views(scene, nothing, frame)])
        if frame == 49:
            assert loop.along[0] < 31 and loop.speed[0] < 1
    assert loop.along[0] > 31


def test_worlds_drive_alone_as_in_a_batch() -> None:
    scenes = [queue(), queue(gap=25), road([driving(0, 0, 5, FRAMES)])]
    perceive: list[Perceive] = [truth, nothing, truth]
    together = PseudoClosedLoop(scenes, [0, 0, 3])
    for frame in range(30):
        starts = zip(scenes, perceive, (0, 0, 3), strict=True)
        together.step([views(scene, see, start + frame) for scene, see, start in starts])
    for e, (scene, see, start) in enumerate(zip(scenes, perceive, (0, 0, 3), strict=True)):
        alone = PseudoClosedLoop([scene], [start])
        for frame in range(30):
            alone.step([views(scene, see, start + frame)])
        assert alone.drives()[0] == together.drives()[e]


def test_a_drive_without_frames() -> None:
    (still,) = PseudoClosedLoop([queue()], [0]).drives()
    assert not still.collided and still.mean_speed == 0.0


def test_in_the_town_perfect_perception_never_collides_and_none_mostly_does() -> None:
    source = open_source("town/test")
    scenes = [source.load(name) for name in source.names()[:3]]
    ends = [
        [drive(scene, see)[0].collided for scene in scenes]
        for see in (lambda scene, frame: truth_boxes(scene, frame, int(scene.connected[0]), 32.0), nothing)
    ]
    assert sum(ends[0]) == 0
    assert sum(ends[1]) == 3
