"""DiscoNet: a softmax over the members in every cell (Li et al., NeurIPS 2021, Sec. 3.2: matrix-valued edge weights).

The weight of member j is learned from its map and the centre's; the centre weighs itself too, as in coperception.
Its four layers 2C → 128 → 32 → 8 → 1 are three here, 2C → 32 → 8 → 1, and without normalisation. The centre of a group
without the ego is the mean of its members' maps, as in `v2vnet`; it is no member then and gets no weight. In a group of
one that member's weight is 1: the group is its member's own map.

The paper trains it by distillation from a teacher that fuses points, not maps: `cp_env.detector.training.distillation`.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from cp_env.detector.model.fusion.base import Fusion, Pointwise, Sent, average, average_all, total

OUT_OF_REACH = -1e4  # logit of a member whose map does not cover the cell; its weight is set to 0 besides


class DiscoNet(Fusion):
    """Σ_j w_j F_j with w = softmax_j e(F_centre, F_j) in each cell, over the members that cover it."""

    def __init__(self, channels: int, width: int = 32) -> None:
        super().__init__()
        self.width = width
        self.code = Pointwise(channels, 2 * width)  # the first layer on (centre, member), half by half
        self.hidden = Pointwise(width, 8)
        self.score = Pointwise(8, 1)
        nn.init.zeros_(self.score.weight)  # training starts from the mean
        nn.init.zeros_(self.score.bias)

    def describe(self, one: Float[Tensor, "*n C H W"]) -> Float[Tensor, "*n D H W"]:
        code: Tensor = self.code(one)
        return code

    def fuse(
        self, members: Sequence[Sent], ego: bool, out: Float[Tensor, "C H W"] | None = None
    ) -> Float[Tensor, "C H W"]:
        return total([one.map for one in members], self.weights(members, ego).unbind(), out)

    def weights(self, members: Sequence[Sent], ego: bool) -> Float[Tensor, "M H W"]:
        """w_j of every member in every cell: sums to 1 where any covers it, is 0 for those that do not."""
        covers = torch.stack([one.covers for one in members])
        codes = torch.stack([one.code for one in members if one.code is not None])
        as_centre, as_member = codes.split(self.width, dim=1)
        centre = as_centre[0] if ego else average(list(as_centre), list(covers))  # linear: the mean's is their mean
        return torch.where(covers > 0, self._scores(centre[None], as_member), OUT_OF_REACH).softmax(0) * covers

    def fuse_all(
        self, maps: Tensor, covers: Tensor, codes: Tensor | None, world: Tensor, ego: Tensor
    ) -> Float[Tensor, "B C H W"]:
        assert codes is not None
        as_centre, as_member = codes[world].split(self.width, dim=2)
        centre = torch.where(ego[:, None, None, None], as_centre[:, 0], average_all(as_centre, covers))
        score = self._scores(centre[:, None], as_member)
        weights = torch.where(covers > 0, score, OUT_OF_REACH).softmax(1) * covers
        return torch.einsum("bnchw,bnhw->bchw", maps, weights)

    def _scores(
        self, centre: Float[Tensor, "*b 1 D H W"], member: Float[Tensor, "*b M D H W"]
    ) -> Float[Tensor, "*b M H W"]:
        """e(F_centre, F_j) of every member."""
        score: Tensor = self.score(functional.relu(self.hidden(functional.relu(centre + member))))
        return score.squeeze(-3)
