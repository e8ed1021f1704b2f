"""Live SUMO: files and buildings by hand; scenes that keep the laws, repeat from their seed, and run side by side."""

from __future__ import annotations

import gzip
import pickle
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cp_env.scenes import open_source
from cp_env.scenes.errors import BrokenData
from cp_env.scenes.sumo import config, network, traffic
from cp_env.scenes.sumo.live import CROWD, LiveSumo
from cp_env.scenes.sumo.places import DRIVEN, quarter
from cp_env.testing import check_scenes
from cp_env.types import Scene
from tests.helpers.sumo_networks import NET, configuration, netconvert, netgenerate
from tests.helpers.toy_traffic import line_of_cars


def test_without_sumo_the_way_out_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "a.net.xml").write_text(NET)
    monkeypatch.setitem(sys.modules, "libsumo", None)
    with pytest.raises(ImportError, match=r"\[sumo\]"):
        LiveSumo(tmp_path / "a.net.xml")


@pytest.fixture(scope="module")
def grid(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A town grid of netgenerate's, with one long building along its southern edge."""
    return netgenerate(
        tmp_path_factory.mktemp("grid") / "g.net.xml", "--grid", "--grid.number", "3", "--grid.length", "80"
    )


@pytest.fixture(scope="module")
def furnished(grid: Path) -> LiveSumo:
    return LiveSumo(grid, seed=4, warm_up=20.0)


def same(a: Scene, b: Scene) -> bool:
    return np.array_equal(a.pose, b.pose, equal_nan=True) and np.array_equal(a.obstacles, b.obstacles)


def test_scenes_keep_every_law(furnished: LiveSumo) -> None:
    assert "pickling_changes_nothing" in check_scenes(furnished, scenes=1, frames=2)


def test_a_scene_follows_from_its_number_in_whatever_order(furnished: LiveSumo, grid: Path) -> None:
    names = furnished.names()
    first = furnished.load(names[0])
    assert (first.n_frames, first.dt) == (100, 0.2) and 5 <= first.n_connected <= 8
    again = LiveSumo(grid, seed=4, warm_up=20.0, scenes=3)
    assert again.digest == furnished.digest and again.names() == names[:3]
    assert same(again.load("g-9999999"), furnished.load("g-9999999")), "any number, beyond those listed too"
    assert same(again.load(names[0]), first)
    assert not same(furnished.load(names[1]), first)
    other = LiveSumo(grid, seed=5, warm_up=20.0)
    assert other.digest != furnished.digest and not same(other.load(names[0]), first)
    with pytest.raises(ValueError, match="unknown scene 'g-1'"):
        furnished.load("g-1")


def _elsewhere(job: tuple[bytes, str]) -> Any:
    source, name = pickle.loads(job[0]), job[1]
    scene = source.load(name)
    return scene.pose, scene.obstacles, source.sweeps(scene, [50])[0][0].points


def test_processes_run_side_by_side(furnished: LiveSumo) -> None:
    """Two processes simulate at once, and each gives what this one does."""
    names = furnished.names()[:2]
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        told = list(pool.map(_elsewhere, [(pickle.dumps(furnished), name) for name in names]))
    for name, (pose, obstacles, points) in zip(names, told, strict=True):
        scene = furnished.load(name)
        assert np.array_equal(pose, scene.pose, equal_nan=True) and np.array_equal(obstacles, scene.obstacles)
        assert np.array_equal(points, furnished.sweeps(scene, [50])[0][0].points)


def _large(net: Path, seed: int) -> Scene:
    return LiveSumo(net, seed=seed, warm_up=10.0).load("city-000000")


def test_of_a_large_network_one_quarter_is_driven(tmp_path: Path) -> None:
    """Twelve streets by twelve hold nine hundred vehicles; each seed takes another quarter, in whatever process."""
    net = netgenerate(tmp_path / "city.net.xml", "--grid", "--grid.number", "12", "--grid.length", "130")
    city = network.read_network(net, np.inf)
    part = quarter(city, np.random.default_rng(0))
    full, driven = (config.PER_KM * config.lane_kilometres(streets) for streets in (city, part))
    assert driven < 0.4 * full and full > 2 * CROWD
    ends = np.concatenate([lane.shape for lane in part.lanes])
    assert np.linalg.norm(ends - part.centre, axis=1).max() < DRIVEN
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        one, other = pool.map(_large, [net, net], [1, 2])
    assert min(one.n_connected, other.n_connected) >= 5 and not same(one, other)
    assert same(_large(net, 1), one)


def test_buildings_take_the_place_of_houses(grid: Path, tmp_path: Path) -> None:
    net = tmp_path / "g.net.xml"
    net.write_bytes(grid.read_bytes())
    squares = [f"{x},{y} {x + 50},{y} {x + 50},{y + 50} {x},{y + 50}" for x in (15, 95) for y in (15, 95)]
    polygons = "".join(f'<poly id="{k}" type="building" shape="{shape}"/>' for k, shape in enumerate(squares))
    (tmp_path / "g.poly.xml").write_text(f"<additional>{polygons}</additional>")
    source = LiveSumo(net, furnish="none", warm_up=20.0, vehicles=3)
    scene = source.load(source.names()[0])
    assert 1 <= len(scene.obstacles) <= 4 and np.allclose(scene.obstacles[:, 3:], [50, 50, config.HEIGHT])
    standing = np.ptp(scene.pose[..., :2], axis=0).max(axis=1) == 0
    assert not standing.all(), "nobody is parked; some may wait"
    assert source.digest != LiveSumo(net, furnish="none", warm_up=20.0, vehicles=3, polygons=grid).digest


def test_a_configuration_drives_its_own_demand(grid: Path, tmp_path: Path) -> None:
    """Red lorries of 9.5 m and bicycles: bicycles are no vehicles here, and density scales the lorries."""
    (tmp_path / "g.net.xml").write_bytes(grid.read_bytes())
    ends = ("A0A1", "C2C1"), ("C0B0", "A2B2"), ("A2A1", "C0C1"), ("B1A1", "B1C1")
    flows = "".join(
        f'<flow id="{kind}{k}" type="{kind}" from="{a}" to="{b}" begin="0" end="400" period="4" '
        'departPos="random_free"/>'
        for k, (a, b) in enumerate(ends)
        for kind in ("lorry", "bike")
    )
    types = (
        '<vType id="lorry" vClass="truck" length="9.5" width="2.5" height="3.5"/><vType id="bike" vClass="bicycle"/>'
    )
    (tmp_path / "r.rou.xml").write_text(f"<routes>{types}{flows}</routes>")
    (tmp_path / "g.sumocfg").write_text(
        '<configuration><input><net-file value="g.net.xml"/><route-files value="r.rou.xml"/></input></configuration>'
    )
    source = open_source(f"sumo:{tmp_path / 'g.sumocfg'}?furnish=none&vehicles=3&warm_up=40")
    assert isinstance(source, LiveSumo)
    scene = source.load(source.names()[0])
    assert np.allclose(scene.size, [9.5, 2.5, 3.5])
    sparse = LiveSumo(tmp_path / "g.sumocfg", furnish="none", vehicles=2, warm_up=40.0, density=0.4)
    rng = np.random.default_rng(0)
    crowd = [
        np.isfinite(next(one._simulation(tmp_path, np.random.default_rng(rng.integers(9)))[1].stretches()).pose[..., 0])
        .sum(axis=1)
        .mean()
        for one in (sparse, source)
    ]
    assert crowd[0] < 0.7 * crowd[1]


def test_what_cannot_be_selected_or_driven_is_refused(
    grid: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cp_env.scenes.sumo.live.TRIES", 1)
    with pytest.raises(ValueError, match=r"no 9 connected vehicles stay within 50 m .* raise density or share"):
        LiveSumo(grid, share=0.05, vehicles=9, warm_up=0.0).load("g-000000")
    (tmp_path / "r.rou.xml").write_text('<routes><trip id="t" depart="1" type="none" from="A0A1" to="C2C1"/></routes>')
    (tmp_path / "bad.sumocfg").write_text(
        f'<configuration><input><net-file value="{grid}"/><route-files value="r.rou.xml"/></input></configuration>'
    )
    with pytest.raises(ValueError, match="SUMO refused"):
        LiveSumo(tmp_path / "bad.sumocfg").load("bad-000000")
    assert LiveSumo(grid, warm_up=20.0, vehicles=2).load("g-000000").n_frames == 100, "and the next simulation runs"
    for options, told in (
        ({"density": 0.0}, "density must be above 0"),
        ({"share": 1.5}, r"share in \(0, 1\]"),
        ({"vehicles": 1}, "vehicles 2 or more"),
        ({"begin": 0.0}, r"begin=0 is for the demand of a configuration \(\.sumocfg\)"),
        ({"begin": -1.0}, "begin must be within 0 and 366 days, in seconds: got -1"),
        ({"furnish": "garden"}, "furnish must be one of urban, suburban, intersection, none"),
    ):
        with pytest.raises(ValueError, match=told):
            LiveSumo(grid, **options)


def test_drawn_streets_differ_from_scene_to_scene() -> None:
    pytest.importorskip("libsumo", reason="needs the extra sumo")
    source = LiveSumo("intersection", warm_up=20.0, vehicles=2)
    a, b = (source.load(name) for name in source.names()[:2])
    assert a.kind == "intersection" and len(a.obstacles) > 10 and a.obstacles.shape != b.obstacles.shape


FLOWS = "".join(
    f'<flow id="{{kind}}-{k}" type="{{kind}}" from="{a}" to="{b}" begin="{{begin}}" end="{{end}}" period="{{period}}"/>'
    for k, (a, b) in enumerate([("A0A1", "C2C1"), ("C0B0", "A2B2"), ("A2A1", "C0C1"), ("C2B2", "A0B0")])
)
TYPES = '<vType id="car"/><vType id="bike" vClass="bicycle"/><vType id="tram" vClass="tram"/>'


NODES = ("w", -150, 0), ("e", 150, 0), ("n", 0, 150), ("s", 0, -150)


@pytest.fixture
def town(grid: Path, tmp_path: Path) -> Path:
    """The grid in a folder of the test's own."""
    (tmp_path / "g.net.xml").write_bytes(grid.read_bytes())
    return tmp_path / "g.net.xml"


def test_traffic_that_begins_at_eight_is_found(town: Path) -> None:
    """Cars drive from 8:00 to 8:10 only, and all day long bicycles, which do not count."""
    bikes = FLOWS.format(kind="bike", begin=0, end=80000, period=60)
    path = configuration(town, TYPES + bikes + FLOWS.format(kind="car", begin=28800, end=29400, period=3))
    source = LiveSumo(path, vehicles=3, furnish="none", warm_up=20.0)
    assert source._period.begin == 28800 and source._period.departures == pytest.approx(800)
    scene = source.load(source.names()[0])
    speed = np.linalg.norm(np.diff(scene.pose[:, scene.connected, :2], axis=0), axis=-1) / scene.dt
    assert np.median(speed) > 0 and (scene.size[:, 0] > 4).all(), "cars, no bicycles"
    assert LiveSumo(path, vehicles=3, begin=28800.0).digest != LiveSumo(path, vehicles=3).digest
    named = open_source(f"sumo:{path}?vehicles=3&furnish=none&warm_up=20&begin=28800")
    assert named.load(named.names()[0]).n_connected >= 3


def test_where_nothing_drives_the_hour_that_does_is_named(town: Path) -> None:
    bikes = FLOWS.format(kind="bike", begin=0, end=80000, period=60)
    path = configuration(town, TYPES + bikes + FLOWS.format(kind="car", begin=28800, end=29400, period=3))
    told = (
        r"from 0 s on no car drives \(bicycle drive, and are left out\); most cars of town\.sumocfg, 800, depart in "
        r"the hour from 28800 s: take begin=28800"
    )
    with pytest.raises(ValueError, match=told):
        LiveSumo(path, begin=0.0, warm_up=0.0).load("town-000000")
    path = configuration(town, TYPES + bikes, stem="bikes")
    with pytest.raises(ValueError, match=r"no car drives \(bicycle .* the files of bikes\.sumocfg send no car"):
        LiveSumo(path, warm_up=0.0).load("bikes-000000")
    path = configuration(town, '<flow id="f" begin="0" end="900" period="40" from="A0A1" to="C2C1"/>', stem="few")
    with pytest.raises(ValueError, match=r"from 0 s on at most [12] cars drive at once, and 5 .* a higher density"):
        LiveSumo(path, warm_up=0.0).load("few-000000")


def test_thin_traffic_drives_on_until_enough_meet(tmp_path: Path) -> None:
    """Four crossings 300 m apart and two cars a kilometre of street, as in RESCO's grid4x4: nobody meets at first."""
    net = netgenerate(
        tmp_path / "thin.net.xml", "--grid", "--grid.number", "2", "--grid.length", "300", "-L", "3",
        "--grid.attach-length", "300", "--no-turnarounds", "--default-junction-type", "traffic_light",
    )  # fmt: skip
    ends = ("left0A0", "B0right0"), ("right1B1", "A1left1"), ("top0A1", "A0bottom0"), ("bottom1B0", "B1top1")
    flows = "".join(
        f'<flow id="{k}" from="{a}" to="{b}" begin="0" end="3600" probability="0.03"/>' for k, (a, b) in enumerate(ends)
    )
    source = LiveSumo(configuration(net, flows, stem="thin"), furnish="none")
    stretches = list(source._simulation(tmp_path, np.random.default_rng(0))[1].stretches())
    at_once = [np.isfinite(tracks.pose[..., 0]).sum(axis=1).mean() for tracks in stretches]
    assert len(stretches) == 22 and max(at_once) < 20
    scene = source.load("thin-000000")
    assert scene.n_connected >= 5 and same(scene, LiveSumo(tmp_path / "thin.sumocfg", furnish="none").load(scene.name))


@pytest.mark.parametrize("stem", ["g", "town"])
def test_packed_networks_and_routes_drive(grid: Path, tmp_path: Path, stem: str) -> None:
    net = tmp_path / "g.net.xml.gz"
    net.write_bytes(gzip.compress(grid.read_bytes()))
    flows = TYPES + FLOWS.format(kind="car", begin=0, end=400, period=3)
    (tmp_path / "r.rou.xml.gz").write_bytes(gzip.compress(f"<routes>{flows}</routes>".encode()))
    (tmp_path / "town.sumocfg").write_text(
        '<configuration><net-file value="g.net.xml.gz"/><route-files value="r.rou.xml.gz"/></configuration>'
    )
    path = net if stem == "g" else tmp_path / "town.sumocfg"
    scene = LiveSumo(path, vehicles=3, warm_up=20.0, furnish="none").load(f"{stem}-000000")
    assert scene.n_connected >= 3


def test_trams_bicycles_and_people_are_left_out_and_buses_are_not(town: Path) -> None:
    """Everyone drives at once: of the tracks only cars and buses are left, and the others are named."""
    types = TYPES + '<vType id="bus" vClass="bus"/>'
    flows = "".join(FLOWS.format(kind=kind, begin=0, end=60, period=3) for kind in ("car", "bike", "bus", "tram"))
    person = '<person id="p" depart="0"><walk from="A0A1" to="A1A2"/></person>'
    source = LiveSumo(configuration(town, types + flows + person), warm_up=0.0)
    tracks = next(source._simulation(town.parent, np.random.default_rng(0))[1].stretches())
    assert tracks.left_out == {"bicycle", "tram"}
    assert sorted(np.unique(tracks.size[:, 0])) == [5, 12], "SUMO's car and bus"


def test_bus_lanes_stops_detectors_and_polygons_as_in_bologna(tmp_path: Path) -> None:
    """Buses stop on lanes of their own, nobody is parked there, and the types stand in an additional file."""
    net = netconvert(
        tmp_path / "bologna.net.xml",
        "".join(f'<node id="{n}" x="{x}" y="{y}"/>' for n, x, y in NODES)
        + '<node id="c" x="0" y="0" type="traffic_light"/>',
        "".join(
            f'<edge id="{a}{b}" from="{a}" to="{b}" numLanes="2" speed="9"><lane index="0" allow="bus"/></edge>'
            for n, *_ in NODES
            for a, b in ((n, "c"), ("c", n))
        ),
    )
    (tmp_path / "town.add.xml").write_text(
        '<additional><vTypeDistribution id="mix"><vType id="small" length="4" probability="3"/>'
        '<vType id="van" length="6" probability="1"/></vTypeDistribution><vType id="bus" vClass="bus"/>'
        '<busStop id="s" lane="wc_0" startPos="60" endPos="90"/>'
        '<e1Detector id="d" lane="wc_1" pos="50" period="300" file="NUL"/></additional>'
    )
    (tmp_path / "town.poly.xml").write_text(
        '<additional><poly id="b" type="building" shape="15,15 60,15 60,60 15,60"/></additional>'
    )
    cars = "".join(
        f'<flow id="{a}{b}" type="mix" from="{a}c" to="c{b}" begin="100" end="900" period="6"/>'
        for a, b in ("we", "ew", "ns", "sn")
    )
    bus = (
        '<flow id="bus" type="bus" from="wc" to="ce" begin="100" end="900" period="60">'
        '<stop busStop="s" duration="20"/></flow>'
    )
    more = '<additional-files value="town.add.xml,town.poly.xml"/>'
    source = LiveSumo(configuration(net, cars + bus, more=more), vehicles=3, warm_up=40.0)
    assert source._period.begin == 60 and source._period.departures == pytest.approx(4 * 800 / 6 + 800 / 60)
    scene = source.load("town-000000")
    assert scene.n_connected >= 3 and any(np.allclose(box[3:5], 45) for box in scene.obstacles)
    lanes = [lane for lane in source._network.lanes if not lane.internal]
    assert {(lane.index, lane.cars) for lane in lanes} == {(0, False), (1, True)}
    tracks = next(source._simulation(tmp_path, np.random.default_rng(0))[1].stretches())
    assert {4, 6, 12} >= set(np.unique(tracks.size[:, 0])) >= {4, 12}


def test_a_rail_only_network_is_named(tmp_path: Path) -> None:
    pytest.importorskip("libsumo", reason="needs the extra sumo")
    (tmp_path / "rail.net.xml").write_text(
        '<net><edge id="a" from="x" to="y"><lane id="a_0" index="0" shape="0,0 99,0" allow="rail"/></edge></net>'
    )
    with pytest.raises(BrokenData, match="has no lane for cars; its lanes are for rail"):
        LiveSumo(tmp_path / "rail.net.xml").load("rail-000000")


def test_a_configuration_that_waits_for_a_client_drives_without_one(town: Path) -> None:
    """sumo-rl's `OW-traci.sumocfg` opens a port; here nobody would ever connect to it."""
    flows = TYPES + FLOWS.format(kind="car", begin=0, end=400, period=3)
    path = configuration(town, flows, more='<remote-port value="8813"/>')
    assert LiveSumo(path, vehicles=3, warm_up=20.0, furnish="none").load("town-000000").n_connected >= 3


def test_streets_of_a_kilometre_are_driven_too(tmp_path: Path) -> None:
    """As in sumo-rl's `Nguyen`: no street lies within the quarter that is driven through."""
    net = netgenerate(tmp_path / "long.net.xml", "--grid", "--grid.number", "4", "--grid.length", "1000")
    assert LiveSumo(net, furnish="none", warm_up=10.0, vehicles=2).load("long-000000").n_connected >= 2


def test_the_connected_move_where_others_do(grid: Path) -> None:
    """At a density at which half of the cars wait at signals, each connected one drives ten metres or more."""
    source = LiveSumo(grid, seed=1, warm_up=20.0, density=1.5, furnish="none")
    for name in source.names()[:3]:
        scene = source.load(name)
        driven = np.linalg.norm(np.diff(scene.pose[:, scene.connected, :2], axis=0), axis=-1).sum(axis=0)
        assert (driven >= 9.5).all()


def test_where_nobody_moves_those_who_stand_are_connected(grid: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cp_env.scenes.sumo.live.STRICT", 1)
    jam = line_of_cars(9, 12.0, frames=200)
    streets = network.read_network(grid, np.inf)
    centre = streets.lanes[-1].shape.mean(axis=0)
    jam.pose[..., :2] += centre - jam.pose[0, 4, :2]
    monkeypatch.setattr(traffic, "stretches", lambda *_, **__: (track for track in [jam]))
    scene = LiveSumo(grid, furnish="none").load("g-000000")
    assert scene.n_connected >= 5 and not np.diff(scene.pose[:, scene.connected], axis=0).any()
