"""Streets read from a network file."""

from __future__ import annotations

import gzip
from pathlib import Path

import pytest
import shapely

from cp_env.scenes.sumo import config, network
from tests.cp_env.scenes.sumo.test_live import NET


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
    assert not town.carriageway.intersects(shapely.Point(50, 5))
    (tmp_path / "b.net.xml.gz").write_bytes(gzip.compress(NET.encode()))
    assert network.read_network(tmp_path / "b.net.xml.gz", 50.0).sources == ["in"]
