"""f_T: a sender's map in the ego's frame.

Convention:
    maps          [..., C, H, W]; row ↔ y (the first starts at y = -extent), column ↔ x; values belong to cell centres.
    ego_T_sender  (x, y, yaw) of the sender's grid frame in the ego's; m, m, rad. It takes sender points to ego points.
Sampling is bilinear between cell centres, with zeros outside the sender's map: linear in the maps, and differentiable.
Poses that shift by whole cells, as all grid frames on one lattice do, are not sampled but copied: the same, and faster.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional

Cells = list[tuple[int, int]]
Window = tuple[slice, slice, slice]

TOLERANCE = 1e-4
"""Cells by which a shift may miss a whole number: single precision over a few hundred metres."""

FEW = 4096
"""Shifts whose cells are remembered: as many as there are by up to 32 cells."""


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
    cells = whole_cells(ego_T_sender, maps.shape[-1], extent)
    if cells is not None:
        moved: Tensor = _Shift.apply(maps, cells)
        return moved
    x, y = sender_points(ego_T_sender.to(maps.dtype), maps.shape[-1], extent)
    grid = torch.stack([x, y], dim=-1).reshape(-1, *x.shape[-2:], 2)
    flat = functional.grid_sample(maps.reshape(-1, *maps.shape[-3:]), grid, padding_mode="zeros", align_corners=False)
    return flat.reshape(maps.shape)


def whole_cells(ego_T_sender: Float[Tensor, "*n 3"], size: int, extent: float) -> Cells | None:
    """(columns, rows) by which each map moves, or None if any turns or moves by a fraction of a cell."""
    pose = ego_T_sender.detach().cpu().numpy().reshape(-1, 3)
    cells = pose[:, :2].astype(np.float64) * (size / (2 * extent))
    whole = np.rint(cells)
    if pose[:, 2].any() or (np.abs(cells - whole) > TOLERANCE).any():
        return None
    return [(int(column), int(row)) for column, row in whole.tolist()]


class _Shift(torch.autograd.Function):
    """Maps moved by whole cells. The adjoint of a shift is the shift back; slices and paddings would copy more."""

    @staticmethod
    def forward(ctx: Any, maps: Float[Tensor, "*n C H W"], cells: Cells) -> Float[Tensor, "*n C H W"]:
        ctx.cells = cells
        return _shifted(maps, cells)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None]:
        (gradient,) = gradients
        back: Tensor = _Shift.apply(gradient, [(-column, -row) for column, row in ctx.cells])
        return back, None


def _shifted(maps: Float[Tensor, "*n C H W"], cells: Cells) -> Float[Tensor, "*n C H W"]:
    """The maps moved by (columns, rows), zeros following."""
    flat = maps.reshape(-1, *maps.shape[-3:])
    if maps.device.type != "cpu":
        return _gathered(flat, cells).reshape(maps.shape)
    moved = torch.zeros(flat.shape, dtype=maps.dtype, device=maps.device)
    for one, target, shift in zip(flat, moved, cells, strict=True):
        to, of = _overlap(shift, maps.shape[-1])
        target[to] = one[of]
    return moved.view(maps.shape)


class Moves(NamedTuple):
    """Where the cells of each δ go in the fused maps, and with which weight: one entry a fused map and δ."""

    fused: list[int]  # numbers of the fused maps
    delta: list[int]  # rows of the δ, worlds and slots in one
    to: list[slice]  # cells of the fused map, row after row
    of: list[slice]  # cells of δ
    share: list[Float[Tensor, "1 cells"]]  # weight of each of them; zero where a row ends on the other side
    once: bool  # whether every δ goes to one fused map only


def weighted_moves(
    share: Float[Tensor, "B k 1 H W"],
    world: Int[Tensor, " B"],
    ego_T_sender: Float[Tensor, "E k 3"],
    extent: float,
    sending: Bool[Tensor, "E k"] | None = None,
) -> Moves | None:
    """How the attackers' δ come into the means of some groups.

    Args:
        share: weight of every δ in each cell of the fused map.
        world: the world of each fused map.
        ego_T_sender: poses of the senders; m, m, rad.
        extent: half the side of a map, m.
        sending: whose δ are moved at all; everyone's by default.

    Returns:
        What `add_weighted` needs; None if a map moves by anything but whole cells, or is elsewhere than on the CPU,
        where map by map is no faster.
    """
    size, k = share.shape[-1], share.shape[1]
    cells = whole_cells(ego_T_sender, size, extent) if share.device.type == "cpu" else None
    if cells is None:
        return None
    moves = Moves([], [], [], [], [], once=len(world.unique()) == len(world))
    for b, e in enumerate(world.tolist()):
        for j in range(k) if sending is None else sending[e].nonzero()[:, 0].tolist():
            shift = cells[e * k + j]
            inside, (to, of) = _overlap(shift, size)[0], _run(shift, size)
            kept = torch.zeros_like(share[b, j])
            kept[inside] = share[b, j][inside]
            moves.fused.append(b)
            moves.delta.append(e * k + j)
            moves.to.append(to)
            moves.of.append(of)
            moves.share.append(kept.flatten(1)[:, to])
    return moves


def add_weighted(
    fused: Float[Tensor, "B C H W"], delta: Float[Tensor, "E k C H W"], moves: Moves
) -> Float[Tensor, "B C H W"]:
    """Fused maps with the share of each δ that it has in a group's mean, moved by whole cells; differentiable in δ.

    Args:
        fused: without perturbations, of any precision.
        delta: in the senders' frames.
        moves: see `weighted_moves`.

    Returns:
        The sum, in the precision of `fused`.
    """
    added: Tensor = _AddWeighted.apply(fused, delta, moves)
    return added


class _AddWeighted(torch.autograd.Function):
    """Map by map, so that each stays in the processor's cache; the gradient goes the same way back.

    Sums and products are taken in single precision, in one place that is used again: torch widens whole maps faster
    than it adds or multiplies maps of two precisions.
    """

    @staticmethod
    def forward(ctx: Any, fused: Tensor, delta: Tensor, moves: Moves) -> Tensor:
        ctx.moves, ctx.shape, ctx.dtype = moves, delta.shape, delta.dtype
        added, sent = fused.clone(), delta.flatten(0, 1).flatten(2).unbind()
        rows, product = added.flatten(2).unbind(), torch.empty_like(sent[0])
        wide = None if fused.dtype == delta.dtype else torch.empty_like(product)
        for b, i, to, of, share in zip(*moves[:5], strict=True):
            one = torch.mul(sent[i][:, of], share, out=product[:, of])
            if wide is None:
                rows[b][:, to].add_(one)
            else:
                wide.copy_(rows[b])[:, to].add_(one)
                rows[b].copy_(wide)
        return added

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[None, Tensor, None]:
        (gradient,) = gradients
        moves: Moves = ctx.moves
        back, rows = torch.empty(ctx.shape, dtype=ctx.dtype), gradient.flatten(2).unbind()
        if not (moves.once and len(moves.delta) == len(back.flatten(0, 1))):
            back.zero_()
        places = back.flatten(0, 1).flatten(2).unbind()
        row, last = torch.empty_like(places[0]), -1  # a decoder may give its gradient with the channels last
        for b, i, to, of, share in zip(*moves[:5], strict=True):
            if b != last:
                row, last = row.copy_(rows[b]), b
            if moves.once:  # nothing is there to add to
                torch.mul(row[:, to], share, out=places[i][:, of])
                places[i][:, : of.start] = 0
                places[i][:, of.stop :] = 0
            else:
                places[i][:, of].add_(row[:, to] * share)
        return None, back, None


@lru_cache(maxsize=FEW)
def _run(shift: tuple[int, int], size: int) -> tuple[slice, slice]:
    """The cells of a moved map, row after row, that are filled, and those of the map that they come from."""
    cells = size * size
    by = max(-cells, min(cells, shift[1] * size + shift[0]))
    return slice(max(0, by), cells + min(0, by)), slice(max(0, -by), cells - max(0, by))


@lru_cache(maxsize=FEW)
def _overlap(shift: tuple[int, int], size: int) -> tuple[Window, Window]:
    """The part of a moved map that the map reaches, and the part of the map that it comes from."""
    x, y = max(-size, min(size, shift[0])), max(-size, min(size, shift[1]))
    to = (slice(None), slice(max(0, y), size + min(0, y)), slice(max(0, x), size + min(0, x)))
    of = (slice(None), slice(max(0, -y), size - max(0, y)), slice(max(0, -x), size - max(0, x)))
    return to, of


def _gathered(maps: Float[Tensor, "R C H W"], cells: Cells) -> Float[Tensor, "R C H W"]:
    """The same in one go for all maps, as a GPU wants it: every cell is fetched from where it comes."""
    size = maps.shape[-1]
    shift = torch.tensor(cells, dtype=torch.long).reshape(-1, 2).to(maps.device)
    source = torch.arange(size, device=maps.device) - shift[..., None]  # [R, (column, row), size]
    inside = (source >= 0) & (source < size)
    column, row = source.clamp(0, size - 1).unbind(1)
    index = (row[:, :, None] * size + column[:, None, :]).flatten(1)[:, None].expand(-1, maps.shape[1], -1)
    moved = maps.flatten(2).gather(2, index).unflatten(2, (size, size))
    return moved * (inside[:, 1, :, None] & inside[:, 0, None, :])[:, None]


def copy_into(
    target: Float[Tensor, "M C H W"],
    rows: Sequence[int],
    maps: Sequence[Tensor],
    ego_T_sender: Float[Tensor, "R 3"],
    extent: float,
) -> bool:
    """Write `maps[i]`, moved by whole cells, to row `rows[i]` of `target`; False, and nothing, if any moves otherwise.

    The target may have another precision: the maps are moved in their own, which copies less.
    """
    cells = whole_cells(ego_T_sender, target.shape[-1], extent)
    if cells is None:
        return False
    if target.device.type != "cpu":
        moved = _gathered(torch.stack(list(maps)).to(target.device), cells)
        target.index_copy_(0, numbers(rows, target.device), moved.to(target.dtype))
        return True
    for row, one, shift in zip(rows, maps, cells, strict=True):
        moved = one
        if shift != (0, 0):
            to, of = _overlap(shift, target.shape[-1])
            moved = torch.zeros_like(one)
            moved[to] = one[of]
        target[row].copy_(moved if target.dtype == torch.float32 else moved.float())  # half to bfloat16 has no fast way
    return True


def add_into(
    target: Float[Tensor, "M C H W"],
    rows: Sequence[int],
    maps: Float[Tensor, "R C H W"],
    ego_T_sender: Float[Tensor, "R 3"],
    extent: float,
) -> bool:
    """Add `maps[i]`, moved by whole cells, to row `rows[i]` of `target`; False, and nothing, if any moves otherwise.

    The maps are the caller's to lose: columns that leave the map are cleared in them.
    """
    cells = whole_cells(ego_T_sender, target.shape[-1], extent)
    if cells is None:
        return False
    if target.device.type != "cpu":
        target.index_add_(0, numbers(rows, target.device), _gathered(maps, cells).to(target.dtype))
        return True
    places = target.view(*target.shape[:2], -1)  # never a copy
    wide = None if target.dtype == maps.dtype else torch.empty(places.shape[1:], dtype=maps.dtype)
    for row, one, shift in zip(rows, maps, cells, strict=True):
        to, of = _run(shift, target.shape[-1])  # whole rows at once: they would end on the other side
        _clear_lost(one, shift[0])
        place, moved = places[row], one.flatten(1)[:, of]
        if wide is None:
            place[:, to].add_(moved)
        else:  # as in `_AddWeighted`
            wide.copy_(place)[:, to].add_(moved)
            place.copy_(wide)
    return True


def _clear_lost(one: Float[Tensor, "C H W"], columns: int) -> None:
    """Clear the columns that leave a map which moves by so many."""
    size = one.shape[-1]
    if columns > 0:
        one[..., max(size - columns, 0) :] = 0
    elif columns < 0:
        one[..., : min(-columns, size)] = 0


def numbers(rows: Sequence[int], device: torch.device) -> Int[Tensor, " R"]:
    """Row numbers as an index on a device."""
    return torch.tensor(list(rows), dtype=torch.long).to(device)


def coverage(ego_T_sender: Float[Tensor, "*n 3"], size: int, extent: float) -> Float[Tensor, "*n H W"]:
    """1 where the centre of the ego's cell lies on the sender's map, 0 elsewhere."""
    x, y = sender_points(ego_T_sender, size, extent)
    edge = 1 + 1e-5  # a turn by 90 degrees must not lose a border to rounding
    return ((x.abs() <= edge) & (y.abs() <= edge)).to(ego_T_sender.dtype)
