"""Fusions without weights: mean, maximum and sum over the members whose map covers a cell."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from cp_env.detector.model.fusion.base import Fusion, Sent, average, average_all, total


class Mean(Fusion):
    """The mean of the covering members, summed in ascending order. A group of one is its member's own map."""

    def fuse(
        self, members: Sequence[Sent], ego: bool, out: Float[Tensor, "C H W"] | None = None
    ) -> Float[Tensor, "C H W"]:
        del ego
        return average([one.map for one in members], [one.covers for one in members], out)

    def fuse_all(
        self, maps: Tensor, covers: Tensor, codes: Tensor | None, world: Tensor, ego: Tensor
    ) -> Float[Tensor, "B C H W"]:
        del codes, world, ego
        return average_all(maps, covers)


class Max(Fusion):
    """The channel-wise maximum of the covering members. A group of one is its member's own map."""

    def fuse(
        self, members: Sequence[Sent], ego: bool, out: Float[Tensor, "C H W"] | None = None
    ) -> Float[Tensor, "C H W"]:
        del ego
        lowest = torch.full_like(members[0].map, -torch.inf)
        covered = torch.zeros_like(members[0].covers, dtype=torch.bool)
        highest = lowest
        for one in members:
            here = one.covers > 0
            highest, covered = torch.maximum(highest, torch.where(here, one.map, lowest)), covered | here
        fused: Tensor = torch.where(covered, highest, torch.zeros_like(highest), out=out)
        return fused

    def fuse_all(
        self, maps: Tensor, covers: Tensor, codes: Tensor | None, world: Tensor, ego: Tensor
    ) -> Float[Tensor, "B C H W"]:
        del codes, world, ego
        highest = torch.where(covers[:, :, None] > 0, maps, -torch.inf).amax(1)
        return torch.where((covers > 0).any(1)[:, None], highest, 0.0)


class Sum(Fusion):
    """The sum of the covering members, in ascending order. A group of one is its member's own map."""

    def fuse(
        self, members: Sequence[Sent], ego: bool, out: Float[Tensor, "C H W"] | None = None
    ) -> Float[Tensor, "C H W"]:
        del ego
        return total([one.map for one in members], [one.covers for one in members], out)

    def fuse_all(
        self, maps: Tensor, covers: Tensor, codes: Tensor | None, world: Tensor, ego: Tensor
    ) -> Float[Tensor, "B C H W"]:
        del codes, world, ego
        return torch.einsum("bnchw,bnhw->bchw", maps, covers)
