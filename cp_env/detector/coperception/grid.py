"""What coperception's detector reads: voxels of 0.25 x 0.25 x 0.4 m, ±32 m around the sensor, 13 of them in height.

Convention: `grid[..., z, row, col]`; row grows with y, **col falls with x** (coperception turns its voxels so), cell
(0, 0) is the south-east corner. Heights count from the sensor. A vehicle's voxels span -3 to 2 m; one that stands
higher than any vehicle's is a road-side unit's: -8 to -3 m, as in V2X-Sim.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Int, UInt8
from torch import Tensor

from cp_env.geometry.planar import grid_origin
from cp_env.types import Sweep

EXTENT = 32.0
CELL = 0.25
SIZE = int(2 * EXTENT / CELL)
HEIGHT = 0.4
SLICES = 13
VEHICLE = (-3.0, 2.0)
RSU = (-8.0, -3.0)
RSU_STANDS = 4.5  # m above ground: higher than the roof of a bus


def rasterise(sweeps: Sequence[Sweep], device: torch.device | str = "cpu") -> UInt8[Tensor, "B 13 256 256"]:
    """1 where a sweep has a return in the voxel, else 0; in its sensor's grid frame, by coperception's layout.

    Points on or beyond the faces of the box are dropped, as there.
    """
    grid = torch.zeros((len(sweeps), SLICES, SIZE, SIZE), dtype=torch.uint8, device=device)
    for one, sweep in zip(grid, sweeps, strict=True):
        x, y, z = torch.from_numpy(_from_the_sensor(sweep)).to(device, torch.float64).unbind(1)
        low, high = RSU if sweep.origin[2] > RSU_STANDS else VEHICLE
        inside = (x.abs() < EXTENT) & (y.abs() < EXTENT) & (z > low) & (z < high)
        column, row = (torch.floor((place[inside] + EXTENT) / CELL).long() for place in (x, y))
        slice_ = torch.floor(z[inside] / HEIGHT).long() - math.floor(low / HEIGHT)
        one[slice_, row, SIZE - 1 - column] = 1
    return grid


def _from_the_sensor(sweep: Sweep) -> np.ndarray:
    """The points, [P, 3], horizontally from the grid's origin, vertically from the sensor; m."""
    sensor = sweep.origin[:2]
    return sweep.points + np.append(sensor - grid_origin(sensor), -sweep.origin[2]).astype(sweep.points.dtype)


def from_voxels(indices: Int[np.ndarray, "V 3"]) -> UInt8[Tensor, "13 256 256"]:
    """The grid of one frame from `voxel_indices_0` (x, y, z) of coperception's preprocessed files."""
    grid = torch.zeros((SLICES, SIZE, SIZE), dtype=torch.uint8)
    x, y, z = torch.from_numpy(np.asarray(indices, dtype=np.int64)).unbind(1)
    grid[z, y, SIZE - 1 - x] = 1
    return grid


def pack(grid: UInt8[Tensor, "*n S"]) -> UInt8[Tensor, "*n P"]:
    """Eight voxels of a row to a byte, the first in the highest bit."""
    return (grid.unflatten(-1, (-1, 8)) * _bits(grid)).sum(-1, dtype=torch.uint8)


def unpack(packed: UInt8[Tensor, "*n P"]) -> UInt8[Tensor, "*n S"]:
    """The grid that was packed."""
    return (packed[..., None].bitwise_and(_bits(packed)) > 0).to(torch.uint8).flatten(-2)


def _bits(like: Tensor) -> UInt8[Tensor, "8"]:
    return torch.tensor([128, 64, 32, 16, 8, 4, 2, 1], dtype=torch.uint8, device=like.device)
