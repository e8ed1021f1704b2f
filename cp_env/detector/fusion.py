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
    """Row b: in every cell of world `world[b]`, the mean over those of `groups[b]` whose map covers it; 0 if none does.

    Each row is summed on its own, members in ascending order: a view does not depend on the views asked beside it.
    """
    pairs = zip(received.unbind(), coverage.unbind(), strict=True)
    senders = [list(zip(maps.unbind(), masks.unbind(), strict=True)) for maps, masks in pairs]
    fused = []
    for row, group in zip(world.tolist(), groups.tolist(), strict=True):
        total, count = torch.zeros_like(received[0, 0]), torch.zeros_like(coverage[0, 0])
        for (maps, mask), member in zip(senders[row], group, strict=True):
            if member:
                total, count = torch.addcmul(total, maps, mask), count + mask
        fused.append(total / count.clamp(min=1))
    return torch.stack(fused) if fused else received.new_zeros((0, *received.shape[2:]))
