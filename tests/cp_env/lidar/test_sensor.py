"""The LiDAR against its slow twin, hand-worked scenes, and the laws of `scan`."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
import pytest

from cp_env.lidar import sensor
from cp_env.lidar.raycast import Mount
from cp_env.lidar.sensor import LidarSpec, fan, rings
from cp_env.types import Scene
from tests.helpers.toy_scenes import ToySource, toy_scene
from tests.reference import lidar as textbook

EXACT = LidarSpec((-20.0, -10.0, -5.0, -2.0, -0.5, 3.0), azimuths=60, range_noise=0.0, dropout=0.0, far_dropout=0.0)


def tan(degrees: float) -> float:
    return math.tan(math.radians(degrees))


def street(
    *others: tuple[float, ...], obstacles: tuple[tuple[float, ...], ...] = (), rsu: float | None = None
) -> Scene:
    """A car (row 0) at the origin heading east, 1.5 m high and so its sensor 1.7 m; others as (x, y, yaw, l, w, h)."""
    rows = np.array([(0, 0, 0, 4.5, 1.8, 1.5), *others], dtype=float)
    return Scene(
        name="street",
        kind="urban",
        dt=0.2,
        pose=rows[None, :, :3],
        size=rows[:, 3:],
        connected=np.array([0]),
        rsu=None if rsu is None else np.array([0.0, 0.0, rsu]),
        obstacles=np.array(obstacles, dtype=float).reshape(-1, 6),
    )


# ---- against the twin


@pytest.mark.parametrize("yaw", [0.0, 0.4])
def test_a_scene_without_noise_is_what_the_textbook_says(yaw: float) -> None:
    scene = toy_scene(yaw=yaw)
    [sweeps] = sensor.scan([(scene, 3)], vehicle_spec=EXACT, rsu_spec=EXACT)
    for agent, sweep in enumerate(sweeps):
        carrier = int(scene.connected[agent]) if agent < scene.n_connected else -1
        heading = scene.pose[3, carrier, 2] if carrier >= 0 else 0.0
        mount = Mount(0, *sweep.origin.tolist(), heading, carrier)
        reach, owner = textbook.revolve(sensor.prisms(scene, 3), mount, EXACT.elevations, EXACT.azimuths)
        seen = reach <= EXACT.max_range
        measured = np.linalg.norm(sweep.points - [0, 0, mount.z], axis=1)
        np.testing.assert_allclose(measured, reach[seen], atol=1e-3)
        np.testing.assert_array_equal(sweep.hits, np.bincount(owner[seen & (owner < 14)], minlength=14))


# ---- worked by hand


def test_a_wall_ahead() -> None:
    """Near face at x = 10, 3 m high. From 1.7 m, -20 degrees strikes the ground at 4.67 m, -5 the wall 0.825 m up."""
    scene = street(obstacles=((10.5, 0, 0, 1, 40, 3),))
    [[sweep]] = sensor.scan([(scene, 0)], vehicle_spec=EXACT)
    ahead = sweep.points[np.abs(sweep.points[:, 1]) < 1e-4]
    ahead = ahead[ahead[:, 0] > 0]
    expected = [(1.7 / tan(20), 0.0), (1.7 / tan(10), 0.0)] + [(10, 1.7 + 10 * tan(e)) for e in (-5, -2, -0.5, 3)]
    np.testing.assert_allclose(ahead[:, [0, 2]], expected, atol=1e-4)


def test_a_van_hides_the_car_behind_it_and_the_ground() -> None:
    van, car = (10, 0, 0, 5, 2, 2.3), (20, 0, 0, 4.5, 1.8, 1.5)
    [[hidden]] = sensor.scan([(street(van, car), 0)], vehicle_spec=EXACT)
    [[plain]] = sensor.scan([(street((10, 30, 0, 5, 2, 2.3), car), 0)], vehicle_spec=EXACT)
    assert hidden.hits is not None and plain.hits is not None
    assert hidden.hits[1] > 0 and hidden.hits[2] == 0 and plain.hits[2] > 0
    x, y = hidden.points[:, 0], hidden.points[:, 1]
    shadow = (x > 7.5 + 1e-3) & (np.abs(y) < x / 7.5)  # the wedge past the van's rear corners (7.5, ±1)
    assert not shadow.any()
    assert ((plain.points[:, 0] > 8) & (np.abs(plain.points[:, 1]) < plain.points[:, 0] / 7.5)).any()


def test_the_road_side_unit_sees_the_roof_below_it() -> None:
    """6 m up over an 8 m square of 2.3 m: -60 degrees lands on it 2.14 m away, -30 would at 6.41 m, past its edge."""
    steep = dataclasses.replace(EXACT, elevations=(-60.0, -30.0), azimuths=4)
    scene = street((0, 0, 0, 8, 8, 2.3), rsu=6.0)
    [[_, sweep]] = sensor.scan([(scene, 0)], rsu_spec=steep)
    flat = np.hypot(sweep.points[:, 0], sweep.points[:, 1])
    np.testing.assert_allclose(flat[sweep.points[:, 2] > 1], 3.7 / tan(60), atol=1e-5)
    np.testing.assert_allclose(flat[sweep.points[:, 2] < 1], 6.0 / tan(30), atol=1e-5)
    np.testing.assert_allclose(sorted(sweep.points[:, 2]), [0] * 4 + [2.3] * 4, atol=1e-5)
    np.testing.assert_array_equal(sweep.hits, [0, 4])


def test_a_sensor_inside_a_building_sees_through_it() -> None:
    """Bad data do not blind it: the building it stands in is left out, the wall beyond is not."""
    inside, wall = (0, 0, 0.3, 20, 20, 8), (15.5, 0, 0, 1, 40, 3)
    [[blind]] = sensor.scan([(street(obstacles=(inside, wall)), 0)], vehicle_spec=EXACT)
    [[free]] = sensor.scan([(street(obstacles=(wall,)), 0)], vehicle_spec=EXACT)
    np.testing.assert_array_equal(blind.points, free.points)


def test_open_ground_returns_circles() -> None:
    [[sweep]] = sensor.scan([(street(), 0)], vehicle_spec=EXACT)
    radius = np.hypot(sweep.points[:, 0], sweep.points[:, 1]).reshape(60, 4)  # -0.5 and +3 degrees return nothing
    np.testing.assert_allclose(radius, [[1.7 / tan(e) for e in (20, 10, 5, 2)]] * 60, rtol=1e-6)
    np.testing.assert_allclose(sweep.points[:, 2], 0, atol=1e-5)


def test_points_lie_along_the_worlds_axes_from_the_sensor() -> None:
    """A post to the north of a car that heads west: its points have x ~ 0 and y > 0."""
    scene = dataclasses.replace(street((0, 10, 0, 1, 1, 3)), pose=np.array([[[5, 5, np.pi], [5, 15, 0]]]))
    [[sweep]] = sensor.scan([(scene, 0)], vehicle_spec=dataclasses.replace(EXACT, azimuths=720))
    post = sweep.points[sweep.points[:, 2] > 0.1]
    assert len(post) and np.allclose(post[:, 1], 9.5, atol=1e-4) and (np.abs(post[:, 0]) <= 0.5 + 1e-4).all()
    np.testing.assert_allclose(sweep.origin, [5, 5, 1.7])


def test_a_car_has_a_bonnet_and_a_van_has_not() -> None:
    spec = dataclasses.replace(EXACT, elevations=fan(-12.0, 3.0, 40), azimuths=8)
    for height, lengths in ((1.5, {10.0, 11.2375}), (2.3, {10.0})):
        scene = street(
            (12.25, 0, math.pi, 4.5, 1.8, height)
        )  # its bonnet faces the sensor, the cabin begins 1.2375 m behind
        [[sweep]] = sensor.scan([(scene, 0)], vehicle_spec=spec)
        on = sweep.points[(np.abs(sweep.points[:, 1]) < 1e-4) & (sweep.points[:, 2] > 0.05) & (sweep.points[:, 0] > 0)]
        flanks = {x for x in np.round(on[:, 0].astype(float), 4) if sum(np.isclose(on[:, 0], x, atol=1e-4)) > 2}
        assert flanks == lengths


# ---- laws


def test_a_sweep_does_not_depend_on_its_batch() -> None:
    source = ToySource()
    jobs = [(source.load(name), frame) for name in source.names() for frame in (0, 3, 5, 8, 11)]
    assert len(jobs) > sensor.AT_ONCE
    together = sensor.scan(jobs)
    assert len(together) == 10 and all(len(sweeps) == 6 for sweeps in together)
    for job, sweeps in zip(jobs, together, strict=True):
        [alone] = sensor.scan([job])
        for one, other in zip(sweeps, alone, strict=True):
            np.testing.assert_array_equal(one.points, other.points)
            np.testing.assert_array_equal(one.origin, other.origin)
            np.testing.assert_array_equal(one.hits, other.hits)


def test_every_sensor_frame_and_scene_has_its_own_noise() -> None:
    """Two equal cars stand still on open ground, too far apart to meet: their returns differ by noise alone."""
    pair = street((500, 0, 0, 4.5, 1.8, 1.5))
    still = dataclasses.replace(pair, pose=np.repeat(pair.pose, 2, axis=0), connected=np.array([0, 1]))
    renamed = dataclasses.replace(still, name="other")
    spec = dataclasses.replace(sensor.VEHICLE, dropout=0.0, far_dropout=0.0)
    jobs = [(still, 0), (still, 1), (renamed, 0)]
    sweeps = [sweep.points for each in sensor.scan(jobs, vehicle_spec=spec) for sweep in each]
    assert len(sweeps) == 6
    for one, other in itertools.combinations(sweeps, 2):
        np.testing.assert_allclose(one[:100], other[:100], atol=1.0)
        assert (one[:100] != other[:100]).any(axis=1).mean() > 0.9


def test_noise_and_dropout_have_the_promised_size() -> None:
    """A round of 20,000 rays on open ground, 1.7 m up: -10 degrees is 9.79 m away, -2 degrees 48.7 m."""
    spec = LidarSpec((-10.0, -2.0), azimuths=20_000, max_range=70.0, range_noise=0.05, dropout=0.1, far_dropout=0.4)
    [[sweep]] = sensor.scan([(street(), 0)], vehicle_spec=spec)
    reach = np.linalg.norm(sweep.points - [0, 0, 1.7], axis=1)
    for near, centre in ((reach[reach < 20], 1.7 / math.sin(math.radians(10))), (reach[reach > 20], 48.7117)):
        assert abs(near.mean() - centre) < 0.002 and abs(near.std() - 0.05) < 0.001
        lost = 0.1 + 0.4 * (centre / 70) ** 2
        assert abs(1 - len(near) / 20_000 - lost) < 4 * math.sqrt(lost * (1 - lost) / 20_000)


def test_nothing_beyond_the_range_is_returned() -> None:
    near = dataclasses.replace(sensor.VEHICLE, max_range=20.0, range_noise=0.0)
    for sweep in sensor.scan([(toy_scene(), 0)], vehicle_spec=near, rsu=False)[0]:
        assert np.linalg.norm(sweep.points - [0, 0, sweep.origin[2]], axis=1).max() <= 20.0 + 1e-4


def test_absent_vehicles_reflect_nothing() -> None:
    scene = toy_scene()
    pose = scene.pose.copy()
    pose[0, -1] = np.nan
    gone = dataclasses.replace(scene, pose=pose)
    assert all(s.hits is not None and s.hits[-1] == 0 for s in sensor.scan([(gone, 0)])[0])
    assert any(s.hits is not None and s.hits[-1] > 0 for s in sensor.scan([(scene, 0)])[0])


def test_the_road_side_unit_comes_last_and_can_be_left_out() -> None:
    scene = toy_scene(n_connected=3)
    [with_unit], [without] = sensor.scan([(scene, 0)]), sensor.scan([(scene, 0)], rsu=False)
    assert len(with_unit) == 4 and len(without) == 3 and with_unit[3].origin.tolist() == [5.0, 5.0, 6.0]
    assert len(sensor.scan([(toy_scene(rsu=False), 0)])[0]) == 5
    assert sensor.scan([]) == []


def test_types_of_a_sweep() -> None:
    sweep = sensor.scan([(toy_scene(), 0)])[0][0]
    assert sweep.points.dtype == np.float32 and sweep.points.shape[1] == 3 and np.isfinite(sweep.points).all()
    assert sweep.hits is not None and sweep.hits.shape == (14,) and sweep.hits[0] == 0  # never its own car


def test_bad_input_is_refused() -> None:
    scene = toy_scene()
    with pytest.raises(ValueError, match=r"frame must be in 0\.\.11"):
        sensor.scan([(scene, 12)])
    pose = scene.pose.copy()
    pose[2, 1] = np.nan
    with pytest.raises(ValueError, match=r"\[1\] of 'toy-0' are not in 2"):
        sensor.scan([(dataclasses.replace(scene, pose=pose), 2)])
    with pytest.raises(ValueError, match="above ground"):
        sensor.scan([(street(rsu=0.0), 0)])
    for wrong in ({"elevations": ()}, {"elevations": (0.0,)}, {"azimuths": 0}, {"max_range": 0.0}, {"dropout": -0.1}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            dataclasses.replace(EXACT, **wrong)


def test_beams_are_where_the_makers_say() -> None:
    down = fan(-24.0, 9.0, 32)
    assert down[0] == -24 and down[-1] == 9 and len(down) == 32 and np.all(np.diff(down) > 0)
    gaps = np.diff(down)
    assert gaps[np.argmin(np.abs(np.array(down[:-1]) + 1.5))] < 0.5 < gaps[0]
    radii = [6.0 / tan(-e) for e in rings(6.0, 4.0, 60.0, 10)]
    np.testing.assert_allclose(radii, np.geomspace(60, 4, 10), rtol=1e-4)
