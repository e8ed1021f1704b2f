"""The recording program: streets, traffic, parked rows and the choice of a cast, by hand and on fresh networks."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import shapely

from cp_env.scenes import KINDS, SPLITS, Town
from cp_env.scenes.formats import recording
from cp_env.scenes.sumo import build, network, roadside, selection, traffic
from cp_env.scenes.sumo.record import Args, main, plan
from cp_env.scenes.sumo.traffic import AXLE, _tracks
from cp_env.scenes.sumo.vehicle_sizes import CLASSES, draw_sizes


@pytest.fixture
def simulator() -> None:
    pytest.importorskip("libsumo", reason="needs the extra sumo")
    pytest.importorskip("sumo", reason="needs the extra sumo")


SIZES = np.array([[4.0, 1.8, 1.5], [8.0, 2.4, 3.2]])


def test_a_front_bumper_heading_by_compass_becomes_a_box_centre() -> None:
    """SUMO: 90° is east. A 4 m car whose bumper is at (10, 5) has its centre at (8, 5)."""
    frames = [{"a": (10.0, 5.0, 90.0, "0"), "b": (0.0, 0.0, 180.0, "1")}]
    tracks = _tracks(frames, SIZES)
    assert np.allclose(tracks.pose[0, 0], [8, 5, 0])
    assert np.allclose(tracks.pose[0, 1], [0, 4, -np.pi / 2]), "southbound: the centre lies north of the bumper"
    assert np.allclose(tracks.size, SIZES)


def test_the_rear_axle_follows_the_bumper() -> None:
    """The bumper jumps 0.32 m aside, as between two lanes: the car turns by asin(0.32 / 3.2) at most, not at once."""
    along = np.arange(10) * 1.0
    frames = [{"a": (x, 0.32 * (x > 4), 90.0, "0")} for x in along]
    yaw = _tracks(frames, SIZES).pose[:, 0, 2]
    assert np.allclose(yaw[:5], 0)
    assert np.isclose(yaw[5], np.arctan2(0.32, AXLE * 4 + 1))
    assert (np.diff(yaw[5:]) < 0).all() and yaw[-1] > 0, "and comes back straight"


def test_whoever_sumo_moves_elsewhere_at_once_goes_on_as_another() -> None:
    frames = [{"a": (x, 0.0, 90.0, "0")} for x in (0.0, 1.0, 50.0, 51.0)]
    pose = _tracks(frames, SIZES).pose
    assert pose.shape[1] == 2
    assert np.isfinite(pose[:2, 0]).all() and np.isnan(pose[2:, 0]).all()
    assert np.isnan(pose[:2, 1]).all() and np.isfinite(pose[2:, 1]).all()


def test_whoever_leaves_and_comes_back_is_another() -> None:
    frames: list[dict[str, tuple[float, float, float, str]]] = [{"a": (0.0, 0.0, 90.0, "0")}, {}]
    assert _tracks([*frames, frames[0]], SIZES).pose.shape[1] == 2


@pytest.mark.parametrize("parked", [True, False])
def test_drawn_sizes_belong_to_a_class(parked: bool) -> None:
    sizes = draw_sizes(2000, np.random.default_rng(0), parked=parked)
    inside = [((sizes >= np.array(c.small) - 1e-9) & (sizes <= np.array(c.large) + 1e-9)).all(axis=1) for c in CLASSES]
    assert np.any(inside, axis=0).all()
    assert abs((sizes[:, 0] > 6.5).mean() - sum(c.parked if parked else c.driving for c in CLASSES[4:])) < 0.03


def line_of_cars(n: int, spacing: float, frames: int = selection.FRAMES) -> traffic.Tracks:
    """A queue along x that stands still."""
    pose = np.zeros((frames, n, 3))
    pose[..., 0] = spacing * np.arange(n)
    return traffic.Tracks(pose, np.tile([4.0, 1.8, 1.5], (n, 1)))


def town_without_streets(radius: float) -> network.Streets:
    return network.Streets(Path(), [], shapely.Polygon(), np.zeros((0, 3)), [], [], np.zeros(2), radius)


def test_a_cast_keeps_together() -> None:
    rng = np.random.default_rng(0)
    cast = selection.candidates(line_of_cars(9, 12.0), town_without_streets(200), rng, 1)[0]
    gap = 12.0 * np.abs(cast.connected[1:] - cast.connected[0])
    assert len(cast.connected) >= 5 and gap.max() < selection.RADIO
    assert (np.diff(gap[:4]) >= 0).all() and (np.diff(gap[4:]) >= 0).all()


def test_the_first_partners_spread_out() -> None:
    """At 6 m in a queue every second vehicle is taken first: neighbours would see the same."""
    rng = np.random.default_rng(0)
    cast = selection.candidates(line_of_cars(30, 6.0), town_without_streets(400), rng, 1)[0]
    first = np.sort(cast.connected[:5])
    assert (6.0 * np.diff(first) >= selection.SPREAD).all()


def test_no_cast_without_company_or_far_from_the_middle() -> None:
    rng = np.random.default_rng(0)
    assert selection.candidates(line_of_cars(4, 10.0), town_without_streets(200), rng, 3) == []
    assert selection.candidates(line_of_cars(9, 40.0), town_without_streets(900), rng, 3) == []
    far = line_of_cars(9, 10.0)
    far.pose[..., 1] = 500
    assert selection.candidates(far, town_without_streets(100), rng, 3) == []


def test_of_two_that_drive_through_each_other_the_connected_one_stays() -> None:
    tracks = line_of_cars(5, 10.0)
    pose = tracks.pose.copy()
    pose[50:, 1, 0] = pose[50:, 2, 0] + 1.0  # the second drives into the third
    pose[:, 4] = np.nan
    assert build._peaceful(pose, tracks.size, np.array([0, 1])).tolist() == [0, 1, 3]
    assert build._peaceful(pose, tracks.size, np.array([0, 2])).tolist() == [0, 2, 3]


def test_swept_ground_covers_every_box() -> None:
    rng = np.random.default_rng(0)
    pose = np.cumsum(rng.normal(0.6, 0.2, (40, 3, 3)) * [1, 1, 0.05], axis=0)
    pose[:13, 2] = np.nan
    size = np.tile([4.5, 1.8, 1.5], (3, 1))
    ground = shapely.union_all(build._swept(pose, size))
    for frame in pose[::3]:
        here = ~np.isnan(frame[:, 0])
        assert shapely.covers(
            ground.buffer(1e-6), roadside.footprints(np.column_stack([frame[here], size[here]]))
        ).all()


def test_plan_names_every_scene_once() -> None:
    names = plan(2, 1, 1)
    assert list(names) == list(SPLITS) and len(names["train"]) == 2 * len(KINDS)
    assert len({name for split in names.values() for name in split}) == 4 * len(KINDS)


@pytest.mark.usefixtures("simulator")
@pytest.mark.parametrize("kind", KINDS)
def test_fresh_streets_are_furnished_beside_the_road(kind: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    town = network.build_streets(*network.draw_streets(kind, rng), tmp_path)
    assert town.sources and town.sinks and (town.junctions[:, 2] == 1).any(), "signals somewhere"
    path = np.linspace([-20, 0], [20, 0], 100)
    where = shapely.Point(10, 0).buffer(15)  # traffic came by here
    furnished = roadside.furnish(town, kind, path, np.array([where]), rng, 60.0)
    cars = roadside.footprints(np.column_stack([furnished.pose, furnished.size]))
    solid = roadside.footprints(furnished.obstacles)
    assert len(cars) > 20 and len(solid) > 20
    assert not shapely.intersects(town.carriageway, np.concatenate([cars, solid])).any()
    assert not shapely.intersects(where, np.concatenate([cars, solid])).any()
    tree = shapely.STRtree(np.concatenate([cars, shapely.buffer(solid, -0.01)]))
    a, b = tree.query(tree.geometries, predicate="intersects")
    assert (a == b).all(), "nothing stands in anything"
    rsu = roadside.place_rsu(town, furnished, path, rng)
    assert not shapely.dwithin(shapely.Point(rsu[:2]), solid, 0.2).any()
    assert 0.5 < shapely.distance(shapely.Point(rsu[:2]), town.carriageway) < 1.5


@pytest.mark.usefixtures("simulator")
def test_the_same_seed_records_the_same_file_and_another_seed_another(tmp_path: Path) -> None:
    name = "test-intersection-00"
    for k in range(2):
        recording.write(tmp_path / f"{k}.npz", build.record(name, "intersection", seed=5))
    assert (tmp_path / "0.npz").read_bytes() == (tmp_path / "1.npz").read_bytes()
    other = Town("test").load(name)  # of another seed
    assert recording.read(tmp_path / "0.npz", name).obstacles.tolist() != other.obstacles.tolist()


@pytest.mark.usefixtures("simulator")
def test_a_killed_run_goes_on(tmp_path: Path) -> None:
    town = Town("test")
    scene = town.load(town.names()[0])
    names = plan(1, 0, 0)["train"]
    for name in names:
        recording.write(tmp_path / f"{name}.npz", scene)
    before = {path.name: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    main(Args(out=tmp_path, train=1, calibration=0, test=0))
    assert {name: (tmp_path / name).stat().st_mtime_ns for name in before} == before, "nothing was recorded again"
    assert Town("train", tmp_path).names() == tuple(names)


def test_without_sumo_the_way_out_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "sumo", None)
    monkeypatch.setitem(sys.modules, "libsumo", None)
    rng = np.random.default_rng(0)
    with pytest.raises(ImportError, match=r"\[sumo\]"):
        network.build_streets(*network.draw_streets("urban", rng), tmp_path)
    with pytest.raises(ImportError, match=r"\[sumo\]"):
        traffic.drive(town_without_streets(10), tmp_path, rng, crowd=3)
