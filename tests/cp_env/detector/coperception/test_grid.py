"""The voxel grid of coperception's preprocessing."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from cp_env.detector.coperception import grid
from cp_env.types import Sweep
from tests.helpers.coperception_views import AGENTS, voxels


def sweep(height: float) -> Sweep:
    rng = np.random.default_rng(0)
    points = rng.uniform([-40, -40, -1], [40, 40, 8], size=(4000, 3)).astype(np.float32)
    return Sweep(points, np.array([101.3, -57.9, height]))


@pytest.mark.parametrize(("height", "low"), [(1.9, -3.0), (6.0, -8.0)])
def test_voxels_as_their_preprocessing_makes_them(height: float, low: float) -> None:
    """Indices by floor, from the lowest voxel on; then a turn by three quarters. The road-side unit looks lower."""
    one = sweep(height)
    points = one.points.astype(np.float64) + np.array([101.3 - 102.0, -57.9 + 58.0, -height])
    inside = (np.abs(points[:, :2]) < 32).all(1) & (points[:, 2] > low) & (points[:, 2] < low + 5)
    indices = np.floor(points[inside] / [0.25, 0.25, 0.4]).astype(int)
    indices -= np.floor(np.array([-32, -32, low]) / [0.25, 0.25, 0.4]).astype(int)
    volume = np.zeros((256, 256, 13), dtype=bool)
    volume[tuple(indices.T)] = True
    wanted = torch.from_numpy(np.rot90(volume, 3).transpose(2, 0, 1).copy()).to(torch.uint8)
    made = grid.rasterise([one])[0]
    assert int((made != wanted).sum()) <= 2, "single precision may round a point over an edge"
    assert int(made.sum()) > 500 and torch.equal(grid.from_voxels(indices), wanted)


def test_packing_loses_nothing() -> None:
    packed = grid.pack(voxels())
    assert packed.shape == (AGENTS, 13, 256, 32) and torch.equal(grid.unpack(packed), voxels())
