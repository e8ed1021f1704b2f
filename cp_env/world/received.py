"""Maps in the ego's frame: moved and written, or added, straight to their place in one large tensor.

A detector that moves maps as ours does has whole cells copied. Any other is asked for its own `warp`, frame by frame or
world by world, so that no neighbour changes a bit.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float, Shaped
from torch import Tensor

from cp_env.detector.model import warp
from cp_env.detector.model.base import moves_as_ours
from cp_env.detector.protocol import DetectorLike


def write(
    detector: DetectorLike,
    target: Float[Tensor, "M C H W"],
    rows: Sequence[int],
    maps: Sequence[Shaped[Tensor, "C H W"]],
    ego_T_sender: Float[Tensor, "R 3"],
    together: int | None = None,
) -> None:
    """Write each of R maps, moved to the ego's frame, to its row of `target`.

    Args:
        detector: whose warp moves them.
        target: on the detector's device.
        rows: one a map.
        maps: in their senders' frames, in any precision, on any device.
        ego_T_sender: their poses; m, m, rad.
        together: how many maps a frame has, if there are several frames: no other's maps are in a batch with its own.
    """
    if moves_as_ours(detector) and warp.copy_into(target, rows, maps, ego_T_sender, detector.extent):
        return
    step = together or len(maps)
    for start in range(0, len(maps), step):
        part = slice(start, start + step)
        whole = torch.stack(list(maps[part])).to(target.device, target.dtype)
        target.index_copy_(
            0, warp.numbers(rows[part], target.device), detector.warp(whole, ego_T_sender[part].to(target.device))
        )


def add(
    detector: DetectorLike,
    target: Float[Tensor, "M C H W"],
    rows: Sequence[int],
    maps: Float[Tensor, "R C H W"],
    ego_T_sender: Float[Tensor, "R 3"],
) -> None:
    """Add each of R maps, moved to the ego's frame, to its row of `target`; no row twice. See `write`.

    The maps are the caller's to lose: what of them leaves the ego's map may be cleared.
    """
    if moves_as_ours(detector) and warp.add_into(target, rows, maps, ego_T_sender, detector.extent):
        return
    warped = detector.warp(maps, ego_T_sender.to(target.device)).to(target.dtype)
    target.index_add_(0, warp.numbers(rows, target.device), warped)
