"""Streets read from a network file."""

from __future__ import annotations

import gzip
from pathlib import Path

import pytest
import shapely

from cp_env.scenes.errors import BrokenData
from cp_env.scenes.sumo import config, network
from tests.helpers.sumo_networks import NET


def test_streets_are_those_for_cars(tmp_path: Path) -> None:
    """The sidewalk, the walking area and the rails are left out; the lane next to the sidewalk is the rightmost."""
    (tmp_path / "a.net.xml").write_text(NET)
    town = network.read_network(tmp_path / "a.net.xml", 50.0)
    assert [(lane.edge, lane.index, lane.internal) for lane in town.lanes] == [
        (":j_0", 0, True),
        ("in", 0, False),
        ("out", 0, False),
    ]
    assert (town.sources, town.sinks) == (["in"], ["out"])
    assert town.junctions.tolist() == [[0, 0, 1]]
    assert config.lane_kilometres(town) == pytest.approx(0.192)
    assert town.carriageway.contains(shapely.Point(50, 5)), "nothing is built on the rails"
    assert not town.carriageway.intersects(shapely.Point(50, 3)), "beside them something may be"
    (tmp_path / "b.net.xml.gz").write_bytes(gzip.compress(NET.encode()))
    assert network.read_network(tmp_path / "b.net.xml.gz", 50.0).sources == ["in"]


@pytest.mark.parametrize(
    ("said", "left"), [("", False), ('lefthand="true"', True), ('lefthand="1"', True), ('lefthand="false"', False)]
)
def test_a_network_says_on_which_side_one_drives(tmp_path: Path, said: str, left: bool) -> None:
    (tmp_path / "a.net.xml").write_text(NET.replace("<net ", f"<net {said} "))
    assert network.read_network(tmp_path / "a.net.xml", 50.0).lefthand is left


def test_a_network_without_cars_says_whom_it_is_for(tmp_path: Path) -> None:
    text = """<net>
        <edge id="a" from="x" to="y"><lane id="a_0" index="0" shape="0,0 9,0" allow="rail rail_urban"/></edge>
        <edge id="b" from="y" to="x"><lane id="b_0" index="0" shape="9,1 0,1" allow="tram"/></edge>
        <edge id=":y_c0" function="crossing"><lane id=":y_c0_0" index="0" shape="0,0 1,1"/></edge>
        <edge id=":y_0" function="internal"><lane id=":y_0_0" index="0" shape="9,0 9,1"/></edge>
    </net>"""
    (tmp_path / "rail.net.xml").write_text(text)
    with pytest.raises(BrokenData, match=r"rail\.net\.xml: has no lane for cars; .* for rail, rail_urban, tram$"):
        network.read_network(tmp_path / "rail.net.xml", 50.0)
    (tmp_path / "none.net.xml").write_text("<net/>")
    with pytest.raises(BrokenData, match=r"has no lane for cars$"):
        network.read_network(tmp_path / "none.net.xml", 50.0)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('shape="-100,-1.6 -4,-1.6"', 'shape="-100,-1.6"', "lane 'in_1' has 1 points and is 3.2 m wide"),
        ('shape="-100,-1.6 -4,-1.6"', "", "lane 'in_1' has 0 points"),
        ('shape="-100,-1.6 -4,-1.6"', 'shape="-100,-1.6 x,0"', "lane 'in_1': its shape is no list of points"),
        ('shape="-100,-1.6 -4,-1.6"', 'shape="-100 4"', "lane 'in_1': its shape is no list of points"),
        ('shape="-100,-1.6 -4,-1.6"', 'shape="-100,nan 4,0"', "lane 'in_1': a point of its shape is not finite"),
        ('shape="-100,-1.6 -4,-1.6"', 'width="-1" shape="-100,-1.6 -4,-1.6"', "lane 'in_1' .* is -1.0 m wide"),
        ('shape="-100,-1.6 -4,-1.6"', 'width="wide" shape="-100,-1.6 -4,-1.6"', "width='wide' is no number"),
        ('type="traffic_light" x="0"', 'type="traffic_light" x=""', "junction 'j': x='' is no number"),
        ("</net>", "", "is no XML"),
    ],
)
def test_broken_networks_are_told(tmp_path: Path, old: str, new: str, told: str) -> None:
    assert old in NET
    (tmp_path / "a.net.xml").write_text(NET.replace(old, new))
    with pytest.raises(BrokenData, match=told):
        network.read_network(tmp_path / "a.net.xml", 50.0)


def test_streets_that_say_that_they_are_normal_are_streets(tmp_path: Path) -> None:
    (tmp_path / "a.net.xml").write_text(NET.replace('<edge id="in" ', '<edge id="in" function="normal" '))
    assert network.read_network(tmp_path / "a.net.xml", 50.0).sources == ["in"]


@pytest.mark.parametrize(
    ("said", "road", "cars"),
    [
        ("", True, True),
        ('allow="all"', True, True),
        ('allow="passenger bus"', True, True),
        ('allow="bus taxi"', True, False),
        ('disallow="passenger"', True, False),
        ('disallow="tram rail"', True, True),
        ('disallow="all"', False, False),
        ('allow=""', False, False),
        ('allow="bicycle pedestrian"', False, False),
    ],
)
def test_lanes_for_buses_are_road_but_not_for_cars(tmp_path: Path, said: str, road: bool, cars: bool) -> None:
    """Next to a lane for cars lies one, nearer to the kerb: where that is road, the kerb is at its edge."""
    text = NET.replace('allow="pedestrian"/>\n        <lane id="in_1"', f'{said}/>\n        <lane id="in_1"')
    (tmp_path / "a.net.xml").write_text(text)
    town = network.read_network(tmp_path / "a.net.xml", 50.0)
    lanes = [(lane.index, lane.cars) for lane in town.lanes if lane.edge == "in"]
    assert lanes == ([(0, cars), (1, True)] if road else [(0, True)])
    assert town.carriageway.contains(shapely.Point(-50, -4.2)) == road
    assert config.lane_kilometres(town) == pytest.approx(0.288 if cars else 0.192)
