"""What all fusions share: one pass over many groups of many worlds, a row at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

ONE_BY_ONE = ("cpu",)
"""The kinds of device on which groups are fused one after the other, which keeps each in a core's cache."""


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
        if received.device.type not in ONE_BY_ONE:
            return self.together(received, coverage, world, groups)
        rows = list(zip(world.tolist(), groups.tolist(), strict=True))
        here = {e for e, _ in rows}
        maps = {e: received[e].unbind() for e in here}
        covers = {e: coverage[e].to(received.dtype).unbind() for e in here}
        wanted = {(e, i): None for e, group in rows for i, member in enumerate(group) if member}
        sent = {(e, i): Sent(maps[e][i], covers[e][i], self.describe(maps[e][i])) for e, i in wanted}
        teams = [([sent[e, i] for i, member in enumerate(group) if member], group[0]) for e, group in rows]
        if self._recorded(received):
            return torch.stack([self.fuse(members, ego) for members, ego in teams])
        fused = received.new_empty((len(rows), *received.shape[2:]))
        for (members, ego), place in zip(teams, fused, strict=True):
            self.fuse(members, ego, place)
        return fused

    def together(
        self,
        received: Float[Tensor, "E N C H W"],
        coverage: Float[Tensor, "E N H W"],
        world: Int[Tensor, " B"],
        groups: Bool[Tensor, "B N"],
    ) -> Float[Tensor, "B C H W"]:
        """The same without a loop over rows, worlds or vehicles, as a GPU wants it; equal but for rounding."""
        covers = coverage.to(received.dtype)[world] * groups[..., None, None]
        return self.fuse_all(received[world], covers, self.describe(received), world, groups[:, 0])

    def fuse_all(
        self,
        maps: Float[Tensor, "B N C H W"],
        covers: Float[Tensor, "B N H W"],
        codes: Float[Tensor, "E N D H W"] | None,
        world: Int[Tensor, " B"],
        ego: Bool[Tensor, " B"],
    ) -> Float[Tensor, "B C H W"]:
        """`fuse` of all groups at once.

        Args:
            maps: of each group's world, members' or not.
            covers: 1 where the map of a member reaches, else 0.
            codes: what `describe` makes of the maps of all worlds.
            world: of each group.
            ego: whether the ego is a member.

        Returns:
            One fused map a group.
        """
        raise NotImplementedError

    def _recorded(self, received: Float[Tensor, "E N C H W"]) -> bool:
        """Whether someone may ask for gradients: then nothing is written in place."""
        wanted = received.requires_grad or any(weight.requires_grad for weight in self.parameters())
        return torch.is_grad_enabled() and wanted

    def describe(self, one: Float[Tensor, "*n C H W"]) -> Float[Tensor, "*n D H W"] | None:
        """What is computed of a map once, however many groups its sender is in; of many maps at once, too."""
        del one
        return None

    def fuse(
        self, members: Sequence[Sent], ego: bool, out: Float[Tensor, "C H W"] | None = None
    ) -> Float[Tensor, "C H W"]:
        """One group's map.

        Args:
            members: at least one.
            ego: whether the first of them is the ego.
            out: where to write it; a new tensor by default, which is differentiable.

        Returns:
            `out`.
        """
        raise NotImplementedError


class Pointwise(nn.Linear):
    """A 1x1 convolution of one map, as the matrix product it is."""

    def forward(self, x: Float[Tensor, "*n I H W"]) -> Float[Tensor, "*n O H W"]:
        out = self.weight @ x.flatten(-2) + self.bias[:, None]
        return out.unflatten(-1, x.shape[-2:])


def total(
    maps: Sequence[Tensor], weights: Sequence[Tensor], out: Float[Tensor, "C H W"] | None = None
) -> Float[Tensor, "C H W"]:
    """Cell by cell, the weighted sum of the maps, in their order."""
    added: Tensor = torch.mul(maps[0], weights[0], out=out)
    for one, weight in zip(maps[1:], weights[1:], strict=True):
        added = torch.addcmul(added, one, weight, out=out)
    return added


def average(
    maps: Sequence[Tensor], covers: Sequence[Tensor], out: Float[Tensor, "C H W"] | None = None
) -> Float[Tensor, "C H W"]:
    """Cell by cell, the mean of those maps that cover it; 0 where none does."""
    count = covers[0] if len(covers) == 1 else torch.stack(list(covers)).sum(0)
    mean: Tensor = torch.div(total(maps, covers, out), count.clamp(min=1), out=out)
    return mean


def average_all(maps: Float[Tensor, "B N D H W"], covers: Float[Tensor, "B N H W"]) -> Float[Tensor, "B D H W"]:
    """`average` of all groups at once."""
    return torch.einsum("bnchw,bnhw->bchw", maps, covers) / covers.sum(1).clamp(min=1)[:, None]
