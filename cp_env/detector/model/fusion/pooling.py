"""Fusions without weights: mean, maximum and sum over the members whose map covers a cell."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from cp_env.detector.model.fusion.base import Fusion, Sent, average


class Mean(Fusion):
    """The mean of the covering members, summed in ascending order. A group of one is its member's own map."""

    def fuse(self, members: Sequence[Sent], ego: bool) -> Float[Tensor, "C H W"]:
        del ego
        return average([one.map for one in members], [one.covers for one in members])


class Max(Fusion):
    """The channel-wise maximum of the covering members. A group of one is its member's own map."""

    def fuse(self, members: Sequence[Sent], ego: bool) -> Float[Tensor, "C H W"]:
        del ego
        lowest = torch.full_like(members[0].map, -torch.inf)
        covered = torch.zeros_like(members[0].covers, dtype=torch.bool)
        highest = lowest
        for one in members:
            here = one.covers > 0
            highest, covered = torch.maximum(highest, torch.where(here, one.map, lowest)), covered | here
        return torch.where(covered, highest, torch.zeros_like(highest))


class Sum(Fusion):
    """The sum of the covering members, in ascending order. A group of one is its member's own map."""

    def fuse(self, members: Sequence[Sent], ego: bool) -> Float[Tensor, "C H W"]:
        del ego
        total = torch.zeros_like(members[0].map)
        for one in members:
            total = torch.addcmul(total, one.map, one.covers)
        return total
