"""Live SUMO: files and buildings by hand; scenes that keep the laws, repeat from their seed, and run side by side."""

from __future__ import annotations

import pickle
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cp_env.scenes import open_source
from cp_env.scenes.sumo import config, network
from cp_env.scenes.sumo.live import CROWD, DRIVEN, LiveSumo, _quarter
from cp_env.testing import check_scenes
from cp_env.types import Scene

NET = """<net version="1.20">
    <edge id=":j_0" function="internal">
        <lane id=":j_0_0" index="0" speed="9" length="8" shape="-4,-1.6 4,-1.6"/>
    </edge>
    <edge id=":j_w0" function="walkingarea"><lane id=":j_w0_0" index="0" shape="0,0 1,1" allow="pedestrian"/></edge>
    <edge id="in" from="west" to="j">
        <lane id="in_0" index="0" speed="9" length="96" width="2" shape="-100,-4.2 -4,-4.2" allow="pedestrian"/>
        <lane id="in_1" index="1" speed="9" length="96" shape="-100,-1.6 -4,-1.6" disallow="tram rail"/>
    </edge>
    <edge id="out" from="j" to="east">
        <lane id="out_0" index="0" speed="9" length="96" shape="4,-1.6 100,-1.6"/>
    </edge>
    <edge id="rails" from="j" to="east"><lane id="rails_0" index="0" shape="4,5 100,5" allow="rail"/></edge>
    <junction id="west" type="dead_end" x="-100" y="0" shape="-100,0 -100,-3.2"/>
    <junction id="j" type="traffic_light" x="0" y="0" shape="-4,0 4,0 4,-3.2 -4,-3.2"/>
    <junction id="east" type="dead_end" x="100" y="0" shape="100,0 100,-3.2"/>
</net>
"""


def test_without_sumo_the_way_out_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "a.net.xml").write_text(NET)
    monkeypatch.setitem(sys.modules, "libsumo", None)
    with pytest.raises(ImportError, match=r"\[sumo\]"):
        LiveSumo(tmp_path / "a.net.xml")


@pytest.fixture(scope="module")
def grid(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A town grid of netgenerate's, with one long building along its southern edge."""
    pytest.importorskip("libsumo", reason="needs the extra sumo")
    sumo = pytest.importorskip("sumo", reason="needs the extra sumo")
    folder = tmp_path_factory.mktemp("grid")
    command = [f"{sumo.SUMO_HOME}/bin/netgenerate", "--grid", "--grid.number", "3", "--grid.length", "80"]
    subprocess.run([*command, "-o", str(folder / "g.net.xml"), "--no-warnings"], check=True, capture_output=True)
    return folder / "g.net.xml"


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
    pytest.importorskip("libsumo", reason="needs the extra sumo")
    sumo = pytest.importorskip("sumo", reason="needs the extra sumo")
    net = tmp_path / "city.net.xml"
    command = [f"{sumo.SUMO_HOME}/bin/netgenerate", "--grid", "--grid.number", "12", "--grid.length", "130"]
    subprocess.run([*command, "-o", str(net), "--no-warnings"], check=True, capture_output=True)
    city = network.read_network(net, np.inf)
    quarter = _quarter(city, np.random.default_rng(0))
    full, driven = (config.PER_KM * config.lane_kilometres(part) for part in (city, quarter))
    assert driven < 0.4 * full and full > 2 * CROWD
    ends = np.concatenate([lane.shape for lane in quarter.lanes])
    assert np.linalg.norm(ends - quarter.centre, axis=1).max() < DRIVEN
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
    scene = source.load(source.names()[0])
    assert np.allclose(scene.size, [9.5, 2.5, 3.5])
    sparse = LiveSumo(tmp_path / "g.sumocfg", furnish="none", vehicles=2, warm_up=40.0, density=0.4)
    rng = np.random.default_rng(0)
    crowd = [
        np.isfinite(one._drive(tmp_path, np.random.default_rng(rng.integers(9)))[1].pose[..., 0]).sum(axis=1).mean()
        for one in (sparse, source)
    ]
    assert crowd[0] < 0.7 * crowd[1]


def test_what_cannot_be_selected_or_driven_is_refused(
    grid: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cp_env.scenes.sumo.live.TRIES", 1)
    with pytest.raises(ValueError, match=r"no 9 connected vehicles stay within 50 m .* raise density or share"):
        LiveSumo(grid, share=0.05, vehicles=9, warm_up=0.0).load("g-000000")
    (tmp_path / "r.rou.xml").write_text('<routes><trip id="t" depart="x" from="A0A1" to="C2C1"/></routes>')
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
        ({"furnish": "garden"}, "furnish must be one of urban, suburban, intersection, none"),
    ):
        with pytest.raises(ValueError, match=told):
            LiveSumo(grid, **options)  # type: ignore[arg-type]


def test_drawn_streets_differ_from_scene_to_scene() -> None:
    pytest.importorskip("libsumo", reason="needs the extra sumo")
    source = LiveSumo("intersection", warm_up=20.0, vehicles=2)
    a, b = (source.load(name) for name in source.names()[:2])
    assert a.kind == "intersection" and len(a.obstacles) > 10 and a.obstacles.shape != b.obstacles.shape
