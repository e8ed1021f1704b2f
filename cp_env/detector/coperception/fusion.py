"""coperception's five fusions, for any group: without the ego, of one vehicle.

coperception only fuses groups with the ego, which stands first. What is ours: without the ego, the centre that V2VNet
and DiscoNet need is the mean of the members' maps, and V2VNet's messages come from all members; a vehicle alone is its
own map (V2VNet: coperception's own rule for a link that is down). Cells out of a member's range hold zeros and count,
as there: a mean over five is a mean over five everywhere.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn import functional

from cp_env.detector.coperception.backbone import CHANNELS
from cp_env.detector.coperception.checkpoint import Weights, layer

Maps = Float[Tensor, "M C H W"]
Map = Float[Tensor, "C H W"]


class Fusion(nn.Module):
    """Row b of the result fuses `groups[b]` of world `world[b]`; vehicle 0 is the ego."""

    def forward(
        self, received: Float[Tensor, "E N C H W"], world: Int[Tensor, " B"], groups: Bool[Tensor, "B N"]
    ) -> Float[Tensor, "B C H W"]:
        members = [received[e][group] for e, group in zip(world.tolist(), groups, strict=True)]
        return torch.stack([self.fuse(maps, bool(group[0])) for maps, group in zip(members, groups, strict=True)])

    def fuse(self, maps: Maps, ego: bool) -> Map:
        """One group; the first map is the ego's if `ego` is true."""
        raise NotImplementedError


class Elementwise(Fusion):
    """`mean`, `max` or `sum`."""

    def __init__(self, reduce: Callable[[Tensor], Tensor]) -> None:
        super().__init__()
        self._reduce = reduce

    def fuse(self, maps: Maps, ego: bool) -> Map:
        del ego
        return self._reduce(maps)


def mean(maps: Maps) -> Map:
    """The mean of the maps, cell by cell."""
    return maps.mean(0)


def largest(maps: Maps) -> Map:
    """The largest of the maps, cell by cell."""
    return maps.max(0).values


def total(maps: Maps) -> Map:
    """The sum of the maps, cell by cell."""
    return maps.sum(0)


class V2VNet(Fusion):
    """Rounds of one message, the mean of the others' own maps, taken up by a convolutional GRU without memory.

    The GRU's hidden state is zero in every round, so it reduces to (1 - z) ∘ n, and the weights on the hidden state to
    their biases. Its kernels are not symmetric: maps are turned into the layout they were trained in, and back.
    """

    def __init__(self, weights: Weights, rounds: int, flips: tuple[int, ...]) -> None:
        super().__init__()
        self.rounds, self.flips = rounds, flips
        weight = weights.take("convgru.weight_ih_l0", 3 * CHANNELS, 2 * CHANNELS, 3, 3)
        bias = weights.take("convgru.bias_ih_l0", 3 * CHANNELS)
        self.from_state = layer(weight[:, :CHANNELS], torch.zeros_like(bias))
        self.from_message = layer(weight[:, CHANNELS:], bias)
        self.memory = nn.Parameter(weights.take("convgru.bias_hh_l0", 3 * CHANNELS)[:, None, None])

    def fuse(self, maps: Maps, ego: bool) -> Map:
        if len(maps) == 1:
            return maps[0]
        maps = maps.flip(self.flips)
        state, others = (maps[0], maps[1:]) if ego else (maps.mean(0), maps)
        heard = self.from_message(others.mean(0))
        reset0, update0, new0 = self.memory.chunk(3)
        for _ in range(self.rounds):
            reset, update, new = (self.from_state(state) + heard).chunk(3)
            reset, update = (reset + reset0).sigmoid(), (update + update0).sigmoid()
            state = (1 - update) * torch.tanh(new + reset * new0)
        return state.flip(self.flips)


class DiscoNet(Fusion):
    """A weight for every member and cell: softmax over the members of what a small network says of (centre, member)."""

    def __init__(self, weights: Weights) -> None:
        super().__init__()
        widths = (2 * CHANNELS, 128, 32, 8, 1)
        self.judge = nn.Sequential()
        for number, (into, out) in enumerate(pairwise(widths), start=1):
            norm = f"pixel_weighted_fusion.bn1_{number}" if out > 1 else None
            conv = weights.conv(f"pixel_weighted_fusion.conv1_{number}", norm, (out, into, 1, 1))
            self.judge.extend([layer(*conv), nn.ReLU()])

    def fuse(self, maps: Maps, ego: bool) -> Map:
        centre = maps[0] if ego else maps.mean(0)
        score = self.judge(torch.cat([centre.expand_as(maps), maps], dim=1))
        return (functional.softmax(score, dim=0) * maps).sum(0)


def make(name: str, weights: Weights, rounds: int, flips: tuple[int, ...]) -> Fusion:
    """The fusion called `name`."""
    if name == "v2vnet":
        return V2VNet(weights, rounds, flips)
    if name == "disconet":
        return DiscoNet(weights)
    return Elementwise({"mean": mean, "max": largest, "sum": total}[name])
