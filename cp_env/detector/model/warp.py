"""f_T: a sender's map in the ego's frame.

Convention:
    maps          [..., C, H, W]; row ↔ y (the first starts at y = -extent), column ↔ x; values belong to cell centres.
    ego_T_sender  (x, y, yaw) of the sender's grid frame in the ego's; m, m, rad. It takes sender points to ego points.
Sampling is bilinear between cell centres, with zeros outside the sender's map: linear in the maps, and differentiable.
Poses that shift by whole cells, as all grid frames on one lattice do, are not sampled but copied: the same, and faster.
"""

from __future__ import annotations

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

TOLERANCE = 1e-4
"""Cells by which a shift may miss a whole number: single precision over a few hundred metres."""


def sender_points(
    ego_T_sender: Float[Tensor, "*n 3"], size: int, extent: float
) -> tuple[Float[Tensor, "*n H W"], Float[Tensor, "*n H W"]]:
    """x and y, in the sender's frame and in units of `extent`, of the centre of every cell of the ego's map."""
    centre = (2 * torch.arange(size, dtype=ego_T_sender.dtype, device=ego_T_sender.device) + 1) / size - 1
    x, y, yaw = (ego_T_sender[..., i, None, None] for i in range(3))
    dx, dy = centre[None, :] - x / extent, centre[:, None] - y / extent
    cos, sin = torch.cos(yaw), torch.sin(yaw)
    return cos * dx + sin * dy, cos * dy - sin * dx


def warp(
    maps: Float[Tensor, "*n C H W"], ego_T_sender: Float[Tensor, "*m 3"], extent: float
) -> Float[Tensor, "*n C H W"]:
    """The maps as the ego would have drawn them: what lies at p in the sender's frame lies at ego_T_sender · p here."""
    if maps.shape[:-3] != ego_T_sender.shape[:-1]:
        raise ValueError(
            f"a map needs one pose each: maps {tuple(maps.shape)} = [..., C, H, W] come with poses "
            f"{tuple(ego_T_sender.shape)}; pass poses of shape {(*maps.shape[:-3], 3)}"
        )
    cells = _whole_cells(ego_T_sender, maps.shape[-1], extent)
    if cells is not None:
        moved: Tensor = _Shift.apply(maps, cells)
        return moved
    x, y = sender_points(ego_T_sender.to(maps.dtype), maps.shape[-1], extent)
    grid = torch.stack([x, y], dim=-1).reshape(-1, *x.shape[-2:], 2)
    flat = functional.grid_sample(maps.reshape(-1, *maps.shape[-3:]), grid, padding_mode="zeros", align_corners=False)
    return flat.reshape(maps.shape)


def _whole_cells(ego_T_sender: Float[Tensor, "*n 3"], size: int, extent: float) -> list[tuple[int, int]] | None:
    """(columns, rows) by which each map moves, or None if any turns or moves by a fraction of a cell."""
    cells = ego_T_sender[..., :2].reshape(-1, 2).double() * (size / (2 * extent))
    whole = cells.round()
    if bool(ego_T_sender[..., 2].any()) or bool(((cells - whole).abs() > TOLERANCE).any()):
        return None
    return [(int(column), int(row)) for column, row in whole.tolist()]


class _Shift(torch.autograd.Function):
    """Maps moved by whole cells. The adjoint of a shift is the shift back; slices and paddings would copy more."""

    @staticmethod
    def forward(ctx: Any, maps: Float[Tensor, "*n C H W"], cells: list[tuple[int, int]]) -> Float[Tensor, "*n C H W"]:
        ctx.cells = cells
        return _shifted(maps, cells)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None]:
        (gradient,) = gradients
        back: Tensor = _Shift.apply(gradient, [(-column, -row) for column, row in ctx.cells])
        return back, None


def _shifted(maps: Float[Tensor, "*n C H W"], cells: list[tuple[int, int]]) -> Float[Tensor, "*n C H W"]:
    """The maps moved by (columns, rows), zeros following."""
    size = maps.shape[-1]
    moved = torch.zeros(maps.shape, dtype=maps.dtype, device=maps.device)
    pairs = zip(maps.reshape(-1, *maps.shape[-3:]), moved.view(-1, *maps.shape[-3:]), cells, strict=True)
    for one, target, shift in pairs:
        x, y = (max(-size, min(size, s)) for s in shift)
        target[:, max(0, y) : size + min(0, y), max(0, x) : size + min(0, x)] = one[
            :, max(0, -y) : size - max(0, y), max(0, -x) : size - max(0, x)
        ]
    return moved


def coverage(ego_T_sender: Float[Tensor, "*n 3"], size: int, extent: float) -> Float[Tensor, "*n H W"]:
    """1 where the centre of the ego's cell lies on the sender's map, 0 elsewhere."""
    x, y = sender_points(ego_T_sender, size, extent)
    edge = 1 + 1e-5  # a turn by 90 degrees must not lose a border to rounding
    return ((x.abs() <= edge) & (y.abs() <= edge)).to(ego_T_sender.dtype)
