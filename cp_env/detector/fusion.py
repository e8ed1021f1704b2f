"""f_F: the maps of a group's members, warped into the ego's frame, become one."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor


def mean(
    received: Float[Tensor, "E N C H W"],
    coverage: Float[Tensor, "E N H W"],
    world: Int[Tensor, " B"],
    groups: Bool[Tensor, "B N"],
) -> Float[Tensor, "B C H W"]:
    """Row b: the mean, in every cell, over the members of `groups[b]` whose map covers it in world `world[b]`; 0 where none does.

    Each row is summed on its own, members in ascending order, so that a view does not depend on the views asked beside it.
    """
    masked = received * coverage[:, :, None]
    fused = []
    for row, group in zip(world.tolist(), groups, strict=True):
        members = group.nonzero()[:, 0]
        count = coverage[row, members].sum(dim=0).clamp(min=1)
        fused.append(masked[row, members].sum(dim=0) / count)
    return torch.stack(fused) if fused else received.new_zeros((0, *received.shape[2:]))
