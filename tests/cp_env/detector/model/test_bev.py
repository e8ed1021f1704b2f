"""Which cell a point lands in, and what the grid does with the rest."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from cp_env import lidar
from cp_env.detector.model import bev
from cp_env.detector.model.bev import BEV, BevSpec
from cp_env.geometry.planar import grid_origin
from cp_env.types import Sweep
from tests.helpers.toy_scenes import toy_scene


def sweep(*points: tuple[float, float, float]) -> Sweep:
    return Sweep(np.array(points, dtype=np.float32).reshape(-1, 3), np.zeros(3))


def occupied(grid: torch.Tensor) -> list[list[int]]:
    return grid.nonzero().tolist()


def test_a_point_lands_where_we_say() -> None:
    """10.1 m east, 5.3 m south, 0.7 m up: col 42.1 / 0.25 = 168.4, row 26.7 / 0.25 = 106.8, slice 0.6 to 1.0 m."""
    assert occupied(bev.rasterise([sweep((10.1, -5.3, 0.7))])) == [[0, 2, 106, 168]]


def test_the_grid_begins_at_the_lattice_point_next_to_the_sensor() -> None:
    """A sensor at (7.2, -4.9): its grid's origin is (8, -4), so a point 0.1 m north-east of it is at (-0.7, -0.8)."""
    shifted = Sweep(np.array([[0.1, 0.1, 0.7]], dtype=np.float32), np.array([7.2, -4.9, 1.7]))
    assert occupied(bev.rasterise([shifted])) == [[0, 2, int((32 - 0.8) / 0.25), int((32 - 0.7) / 0.25)]]


def test_one_place_in_the_world_is_one_cell_whoever_sees_it() -> None:
    place = np.array([13.3, 9.1])
    cells = []
    for sensor in ([3.1, 4.7], [20.9, -6.2]):
        origin = grid_origin(np.array(sensor))
        seen = Sweep(np.array([[*(place - sensor), 0.7]], dtype=np.float32), np.array([*sensor, 1.7]))
        ((_, _, row, col),) = occupied(bev.rasterise([seen]))
        cells.append(((np.array([col, row]) * 0.25 - 32 + origin) / 0.25).tolist())
    assert cells[0] == cells[1]


def test_the_corners_of_the_grid() -> None:
    inside = [(-32, -32, 0), (31.99, -32, 0), (-32, 31.99, 0), (31.99, 31.99, 0)]
    assert occupied(bev.rasterise([sweep(*inside)])) == [[0, 0, r, c] for r in (0, 255) for c in (0, 255)]
    outside = [(32, 0, 0), (0, 32, 0), (-32.01, 0, 0), (0, -32.01, 0), (500, 500, 0), (-500, 3, 0)]
    assert occupied(bev.rasterise([sweep(*outside)])) == []


def test_slices_part_at_their_edges() -> None:
    heights = [-0.1, 0.2, 0.25, 0.59, 0.6, 1.2, 1.5, 2.0, 2.6, 30.0]
    grid = bev.rasterise([sweep((0.1, 0.1, h)) for h in heights])
    assert [z for _, z, _, _ in occupied(grid)] == [0, 0, 1, 1, 2, 3, 4, 5, 6, 6]


def test_every_view_has_its_own_grid() -> None:
    grid = bev.rasterise([sweep((0.1, 0.1, 0.0)), sweep(), sweep((0.1, 0.1, 0.0), (1, 1, 1))])
    assert grid.shape == (3, BEV.slices, 256, 256) and grid.dtype == torch.uint8
    assert grid.sum((1, 2, 3)).tolist() == [1, 0, 2]
    assert bev.rasterise([]).shape == (0, BEV.slices, 256, 256)


@pytest.mark.parametrize("spec", [BEV, BevSpec(extent=8.0, cell=0.5, edges=(0.5,))])
def test_a_grid_is_what_a_loop_over_points_gives(spec: BevSpec) -> None:
    rng = np.random.default_rng(1)
    clouds = [rng.uniform([-40, -40, -1], [40, 40, 4], (500, 3)).astype(np.float32) for _ in range(2)]
    expected = np.zeros((2, spec.slices, spec.size, spec.size), dtype=np.uint8)
    for view, cloud in enumerate(clouds):
        for x, y, z in cloud.tolist():
            if abs(x) < spec.extent and abs(y) < spec.extent:
                col, row = int((x + spec.extent) / spec.cell), int((y + spec.extent) / spec.cell)
                expected[view, sum(z >= edge for edge in spec.edges), row, col] = 1
    grid = bev.rasterise([Sweep(cloud, np.zeros(3)) for cloud in clouds], spec)
    np.testing.assert_array_equal(grid, expected)


def test_packing_keeps_every_bit_in_an_eighth_of_the_room() -> None:
    grid = bev.rasterise(lidar.scan([(toy_scene(), 0)])[0])
    packed = bev.pack(grid)
    assert packed.nbytes * 8 == grid.numel() and packed.dtype == np.uint8
    assert torch.equal(bev.unpack(packed), grid)
    with pytest.raises(ValueError, match="multiple of 8"):
        bev.pack(grid[..., :12])


def test_bad_grids_are_refused() -> None:
    for wrong in ({"cell": 0.3}, {"cell": 0.0}, {"extent": -1.0}, {"edges": (1.0, 0.5)}, {"edges": (1.0, 1.0)}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            BevSpec(**wrong)  # type: ignore[arg-type]
