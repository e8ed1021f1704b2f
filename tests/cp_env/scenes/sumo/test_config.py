"""Configuration and building files of the simulator."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest
import shapely

from cp_env.scenes.errors import BrokenData
from cp_env.scenes.sumo import config
from cp_env.scenes.sumo.roadside import footprints
from tests.helpers.sumo_networks import NET

POLYGONS = """<additional>
    <poly id="hall" type="building.commercial" shape="10,8 30,8 30,18 10,18 10,8">
        <param key="height" value="12.5"/>
    </poly>
    <poly id="ell" type="building" shape="-40,8 -20,8 -20,14 -34,14 -34,28 -40,28">
        <param key="building:levels" value="4"/>
    </poly>
    <poly id="park" type="leisure.park" shape="-90,30 -50,30 -50,60"/>
    <poly id="shed" type="building" shape="50,8 50.5,8 50.5,8.5"/>
</additional>
"""


def test_buildings_by_hand(tmp_path: Path) -> None:
    """The hall is one box; the L is its six walls, 12 m high; the park is no building, and the shed is too small."""
    (tmp_path / "a.poly.xml").write_text(POLYGONS)
    boxes = config.buildings(tmp_path / "a.poly.xml")
    hall, walls = boxes[0], boxes[1:]
    assert np.allclose(np.sort(hall[3:]), [10, 12.5, 20]) and hall[5] == 12.5 and np.allclose(hall[:2], [20, 13])
    assert footprints(hall[None])[0].equals_exact(shapely.box(10, 8, 30, 18), 1e-9) or footprints(hall[None])[
        0
    ].symmetric_difference(shapely.box(10, 8, 30, 18)).area == pytest.approx(0, abs=1e-9)
    assert len(walls) == 6 and (walls[:, 5] == 12).all() and (walls[:, 4] == config.WALL).all()
    outline = shapely.Polygon([(-40, 8), (-20, 8), (-20, 14), (-34, 14), (-34, 28), (-40, 28)]).exterior
    drawn = shapely.union_all(footprints(walls))
    assert shapely.covers(drawn.buffer(1e-6), outline) and shapely.covers(outline.buffer(0.3), drawn)


def test_a_configuration_names_its_files_and_missing_ones_are_told(tmp_path: Path) -> None:
    (tmp_path / "a.net.xml").write_text(NET)
    (tmp_path / "a.poly.xml").write_text(POLYGONS)
    file = tmp_path / "a.sumocfg"
    file.write_text(
        '<configuration><input><net-file value="a.net.xml"/><route-files value="r.xml"/>'
        '<additional-files value="stops.xml, a.poly.xml"/></input></configuration>'
    )
    with pytest.raises(BrokenData, match=r"r\.xml: is missing; a\.sumocfg names it"):
        config.find(file)
    for name in ("r.xml", "stops.xml"):
        (tmp_path / name).write_text("<routes/>")
    found = config.find(file)
    assert found.net == tmp_path / "a.net.xml" and found.polygons == tmp_path / "a.poly.xml" and found.config == file
    assert len(found.every) == 5
    assert [name.name for name in found.demand] == ["stops.xml", "r.xml"], "types stand in additional files"
    assert (found.begin, found.end) == (0, np.inf)
    bare = config.find(tmp_path / "a.net.xml")
    assert bare.config is None and bare.polygons == tmp_path / "a.poly.xml"
    for content, told in (
        ("<configuration/>", "names no net-file"),
        ("<routes/>", "neither a network nor a configuration of SUMO but a <routes>"),
        ("<net", "is no XML"),
    ):
        file.write_text(content)
        with pytest.raises(BrokenData, match=told):
            config.find(file)
    with pytest.raises(BrokenData, match="cannot be read"):
        config.find(tmp_path / "none.net.xml")
    (tmp_path / "a.poly.xml").write_text('<additional><poly id="x" type="building" shape="1,2 3"/></additional>')
    with pytest.raises(BrokenData, match="polygon 'x'"):
        config.buildings(tmp_path / "a.poly.xml")


def test_an_old_configuration_has_a_root_of_any_name(tmp_path: Path) -> None:
    (tmp_path / "a.net.xml").write_text(NET)
    file = tmp_path / "run.sumo.cfg"
    file.write_text('<c><net-file value="a.net.xml"/></c>')
    assert config.find(file).net == tmp_path / "a.net.xml"
    file.write_text("<c/>")
    with pytest.raises(BrokenData, match="neither a network nor a configuration of SUMO but a <c>"):
        config.find(file)


def test_the_period_of_a_configuration(tmp_path: Path) -> None:
    (tmp_path / "a.net.xml").write_text(NET)
    file = tmp_path / "a.sumocfg"
    told = (
        '<configuration><net-file value="a.net.xml"/><time><begin value="{}"/><end value="{}"/></time></configuration>'
    )
    for begin, end, expected in (
        ("15:0:0", "16:0:0", (54000, 57600)),
        ("28800", "-1", (28800, np.inf)),
        ("", "", (0, np.inf)),
    ):
        file.write_text(told.format(begin, end))
        assert (config.find(file).begin, config.find(file).end) == expected
    file.write_text(told.format("noon", "1"))
    with pytest.raises(BrokenData, match="begin or end: 'noon' is no time"):
        config.find(file)


def test_a_packed_configuration_is_refused_and_a_packed_network_is_not(tmp_path: Path) -> None:
    (tmp_path / "a.net.xml.gz").write_bytes(gzip.compress(NET.encode()))
    assert config.find(tmp_path / "a.net.xml.gz").net == tmp_path / "a.net.xml.gz"
    (tmp_path / "a.sumocfg.gz").write_bytes(gzip.compress(b"<configuration/>"))
    with pytest.raises(BrokenData, match="is a packed configuration, which SUMO does not read: unpack it"):
        config.find(tmp_path / "a.sumocfg.gz")
