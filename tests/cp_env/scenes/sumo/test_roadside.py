"""Parked rows, buildings and the road-side unit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from jaxtyping import Float

from cp_env.scenes import KINDS
from cp_env.scenes.sumo import network, roadside
from tests.helpers.sumo_networks import netgenerate
from tests.helpers.toy_traffic import town_without_streets


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
    assert rsu is not None
    assert not shapely.dwithin(shapely.Point(rsu[:2]), solid, 0.2).any()
    assert 0.5 < shapely.distance(shapely.Point(rsu[:2]), town.carriageway) < 1.5


def mirrored(boxes: Float[np.ndarray, "B d"]) -> Float[np.ndarray, "B d"]:
    """Rows x, y, yaw, ... seen in a mirror that lies along x."""
    return boxes * np.array([1, -1, -1, 1, 1, 1][: boxes.shape[1]])


@pytest.mark.usefixtures("simulator")
@pytest.mark.parametrize("kind", list(roadside.STYLES))
def test_a_left_hand_network_is_furnished_as_the_mirror_image_of_a_right_hand_one(kind: str, tmp_path: Path) -> None:
    town = network.build_streets(*network.draw_streets("suburban", np.random.default_rng(3)), tmp_path)
    lanes = [replace(lane, shape=lane.shape * [1, -1]) for lane in town.lanes]
    flipped = shapely.transform(town.carriageway, lambda points: points * [1, -1])
    other = replace(town, lanes=lanes, carriageway=flipped, junctions=town.junctions * [1, -1, 1], lefthand=True)
    path, swept = np.linspace([-20, 0], [20, 0], 50), np.array([shapely.Point(10, 0).buffer(15)])
    buildings = None if kind != "none" else np.array([[15.0, 15.0, 0.0, 10.0, 10.0, 9.0]])
    right = roadside.furnish(town, kind, path, swept, np.random.default_rng(5), 60.0, buildings)
    flip = None if buildings is None else mirrored(buildings)
    left = roadside.furnish(other, kind, path, swept, np.random.default_rng(5), 60.0, flip)
    assert len(right.obstacles) > 10 or kind == "none"
    assert np.allclose(left.pose, mirrored(right.pose), atol=1e-6) and np.array_equal(left.size, right.size)
    assert np.allclose(left.obstacles, mirrored(right.obstacles), atol=1e-6)


@pytest.mark.usefixtures("simulator")
@pytest.mark.parametrize("lefthand", [False, True])
def test_cars_are_parked_on_the_side_where_one_drives(lefthand: bool, tmp_path: Path) -> None:
    """Seen from the nearest lane, cars parked along its kerb stand outside it and head with its traffic."""
    options = ["--grid", "--grid.number", "2", "--grid.length", "120", "-L", "2", *["--lefthand"] * lefthand]
    town = network.read_network(netgenerate(tmp_path / "g.net.xml", *options), np.inf)
    assert town.lefthand == lefthand
    path = np.linspace([20.0, 60.0], [100.0, 60.0], 50)
    cars = roadside.furnish(town, "urban", path, np.zeros(0, dtype=object), np.random.default_rng(0), 90.0).pose
    lanes = [lane for lane in town.lanes if not lane.internal]
    lines = [shapely.LineString(lane.shape) for lane in lanes]
    along = []
    for x, y, yaw in cars:
        nearest = int(np.argmin(shapely.distance(shapely.Point(x, y), lines)))
        ahead = np.diff(lanes[nearest].shape[:2], axis=0)[0]
        off = np.array([x, y]) - lanes[nearest].shape[0]
        assert lanes[nearest].index == 0
        assert (ahead[0] * off[1] - ahead[1] * off[0] > 0) == lefthand, "on the left of the lane, or on its right"
        along.append(np.cos(yaw - np.arctan2(ahead[1], ahead[0])))
    assert len(along) > 20 and np.mean(np.array(along) > 0.99) > 0.5 and np.min(along) > -0.1


def test_no_pole_stands_where_everything_is_built_over() -> None:
    streets = replace(
        town_without_streets(50), carriageway=shapely.box(-3, -3, 3, 3), junctions=np.array([[0.0, 0.0, 1.0]])
    )
    full = roadside.Layout(np.zeros((0, 3)), np.zeros((0, 3)), np.array([[0.0, 0.0, 0.0, 30.0, 30.0, 9.0]]))
    empty = replace(full, obstacles=np.zeros((0, 6)))
    path = np.zeros((3, 2))
    assert roadside.place_rsu(streets, full, path, np.random.default_rng(0)) is None
    assert roadside.place_rsu(streets, empty, path, np.random.default_rng(0)) is not None
