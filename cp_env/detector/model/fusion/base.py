"""What all fusions share: one pass over many groups of many worlds, a row at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn


@dataclass(frozen=True, eq=False)
class Sent:
    """One sender's map in the ego's frame."""

    map: Float[Tensor, "C H W"]
    covers: Float[Tensor, "H W"]  # 1 where the sender's map reaches, else 0
    code: Float[Tensor, "D H W"] | None  # what a learned fusion makes of the map by itself


class Fusion(nn.Module):
    """f_F. Row b of the result fuses `groups[b]` in world `world[b]`; vehicle 0 is the ego.

    In every cell only those members count whose map covers it; a cell that no member covers is 0. Each row is computed
    by itself, so that a view does not depend, to the last bit, on the other views of its batch.
    """

    def forward(
        self,
        received: Float[Tensor, "E N C H W"],
        coverage: Float[Tensor, "E N H W"],
        world: Int[Tensor, " B"],
        groups: Bool[Tensor, "B N"],
    ) -> Float[Tensor, "B C H W"]:
        rows = list(zip(world.tolist(), groups.tolist(), strict=True))
        maps = [one.unbind() for one in received.unbind()]
        covers = [one.unbind() for one in coverage.unbind()]
        wanted = {(e, i): None for e, group in rows for i, member in enumerate(group) if member}
        sent = {(e, i): Sent(maps[e][i], covers[e][i], self.describe(maps[e][i])) for e, i in wanted}
        fused = [self.fuse([sent[e, i] for i, member in enumerate(group) if member], group[0]) for e, group in rows]
        return torch.stack(fused) if fused else received.new_zeros((0, *received.shape[2:]))

    def describe(self, one: Float[Tensor, "C H W"]) -> Float[Tensor, "D H W"] | None:
        """What is computed of a map once, however many groups its sender is in."""
        del one
        return None

    def fuse(self, members: Sequence[Sent], ego: bool) -> Float[Tensor, "C H W"]:
        """One group's map; the first member is the ego if `ego` is true. There is at least one member."""
        raise NotImplementedError


class Pointwise(nn.Linear):
    """A 1x1 convolution of one map, as the matrix product it is."""

    def forward(self, x: Float[Tensor, "*n I H W"]) -> Float[Tensor, "*n O H W"]:
        out = self.weight @ x.flatten(-2) + self.bias[:, None]
        return out.unflatten(-1, x.shape[-2:])


def average(maps: Sequence[Tensor], covers: Sequence[Tensor]) -> Float[Tensor, "C H W"]:
    """Cell by cell, the mean of those maps that cover it; 0 where none does."""
    total, count = torch.zeros_like(maps[0]), torch.zeros_like(covers[0])
    for one, mask in zip(maps, covers, strict=True):
        total, count = torch.addcmul(total, one, mask), count + mask
    return total / count.clamp(min=1)
