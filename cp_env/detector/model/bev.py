"""LiDAR points as a bird's-eye occupancy grid: what the shared encoder f_E reads.

Convention: `grid[..., row, col]`; row grows with y (north), col with x (east), cell (0, 0) is the south-west corner.
Slice 0 holds the returns from the ground: a cell that was seen to be empty differs from one that was not seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from cp_env.geometry.planar import grid_origin
from cp_env.types import Sweep


@dataclass(frozen=True)
class BevSpec:
    """A square grid of ±extent m with cells of `cell` m, and the heights (m above ground) that part its slices.

    A point at or above the last edge is in the last slice, however high.
    """

    extent: float = 32.0
    cell: float = 0.25
    edges: tuple[float, ...] = (0.25, 0.6, 1.0, 1.4, 1.8, 2.6)

    def __post_init__(self) -> None:
        if self.cell <= 0 or self.extent <= 0 or (2 * self.extent / self.cell) % 1:
            raise ValueError(f"2 * extent must be a whole number of cells: got extent {self.extent}, cell {self.cell}")
        if list(self.edges) != sorted(set(self.edges)):
            raise ValueError(f"edges must rise: got {self.edges}")

    @property
    def size(self) -> int:
        """Cells along one side."""
        return int(2 * self.extent / self.cell)

    @property
    def slices(self) -> int:
        return len(self.edges) + 1


BEV = BevSpec()


def rasterise(sweeps: Sequence[Sweep], spec: BevSpec = BEV, *, device: str = "cpu") -> UInt8[Tensor, "B Z S S"]:
    """1 where a sweep has a return in the cell and slice, else 0; in its sensor's grid frame.

    Points outside the grid are dropped.
    """
    shape = (len(sweeps), spec.slices, spec.size, spec.size)
    grid = torch.zeros(shape, dtype=torch.uint8, device=device)
    if not sweeps:
        return grid
    points = torch.from_numpy(np.concatenate([_on_lattice(sweep) for sweep in sweeps])).to(device)
    counts = torch.tensor([len(sweep.points) for sweep in sweeps], device=device)
    view = torch.repeat_interleave(torch.arange(len(sweeps), device=device), counts)
    cell = torch.floor((points[:, :2] + spec.extent) / spec.cell).long()
    inside = ((cell >= 0) & (cell < spec.size)).all(1)
    height = torch.bucketize(points[:, 2].contiguous(), torch.tensor(spec.edges, device=device), right=True)
    index = ((view * spec.slices + height) * spec.size + cell[:, 1]) * spec.size + cell[:, 0]
    grid.view(-1)[index[inside]] = 1
    return grid


def _on_lattice(sweep: Sweep) -> Float[np.ndarray, "P 3"]:
    """The points from the grid origin instead of the sensor."""
    sensor = sweep.origin[:2]
    return sweep.points + np.append(sensor - grid_origin(sensor), 0.0).astype(sweep.points.dtype)


def pack(grid: UInt8[Tensor, "*b S"]) -> UInt8[np.ndarray, "*b P"]:
    """Eight cells of a row to a byte; S must be a multiple of 8."""
    if grid.shape[-1] % 8:
        raise ValueError(f"rows must be a multiple of 8 cells long to be packed: got {grid.shape[-1]}")
    return np.packbits(grid.cpu().numpy(), axis=-1)


def unpack(packed: UInt8[np.ndarray, "*b P"]) -> UInt8[Tensor, "*b S"]:
    """The grid that was packed."""
    return torch.from_numpy(np.unpackbits(packed, axis=-1))
