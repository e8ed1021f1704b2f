"""Parked rows, buildings and the road-side unit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapely

from cp_env.scenes import KINDS
from cp_env.scenes.sumo import network, roadside


@pytest.mark.usefixtures("simulator")
@pytest.mark.parametrize("kind", KINDS)
def test_new_streets_have_walls_next_to_the_road(kind: str, tmp_path: Path) -> None:
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
