"""V2VNet: rounds of messages to the centre, taken up by a convolutional GRU (Wang et al., ECCV 2020, Sec. 3).

The paper is read as coperception reads it: only the ego is decoded, so only the centre's state is updated, and what
the others send are their own maps in every round. What is ours:

* The state has 32 channels where the map has 128, and its convolutions are depthwise, then pointwise, so that a view
  costs about twice one of the mean; what the state has no room for comes through the mean of the group, to which the
  rounds add (a residual where the paper has an MLP alone).
* The centre of a group without the ego is the mean of its members' maps: the ego's grid is where the view is wanted,
  but no member stands for the ego, and a mean neither depends on their order nor leaves cells blank that any covers.
* Messages come from all members but the ego. A cell covered by one member only hears of nothing: that member's own map
  stands, so a group of one is its member's own map.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from cp_env.detector.model.fusion.base import Fusion, Pointwise, Sent, average, average_all

ROUNDS = 3


class V2VNet(Fusion):
    """Three rounds: m = mean over senders j of ReLU(P F_j + Q h), h ← ConvGRU(h, m), from h = ReLU(S F_centre)."""

    def __init__(self, channels: int, width: int = 32) -> None:
        super().__init__()
        self.width = width
        self.code = Pointwise(channels, 2 * width)  # of one map: S F and P F
        self.listen = Pointwise(width, width)  # Q
        self.gru = ConvGru(width)
        self.out = Pointwise(width, channels)
        nn.init.zeros_(self.out.weight)  # training starts from the mean
        nn.init.zeros_(self.out.bias)

    def describe(self, one: Float[Tensor, "*n C H W"]) -> Float[Tensor, "*n D H W"]:
        code: Tensor = self.code(one)
        return code

    def fuse(
        self, members: Sequence[Sent], ego: bool, out: Float[Tensor, "C H W"] | None = None
    ) -> Float[Tensor, "C H W"]:
        mean = average([one.map for one in members], [one.covers for one in members], out)
        heard = torch.stack([one.covers for one in members]).sum(0) > 1
        if not bool(heard.any()):
            return mean
        codes = torch.stack([one.code for one in members if one.code is not None])
        covers = torch.stack([one.covers for one in members])[:, None]
        state, messages = codes.split(self.width, dim=1)
        first = state[0] if ego else _mean(state, covers)
        others = slice(1, None) if ego else slice(None)
        h = functional.relu(first)
        for _ in range(ROUNDS):
            message = _mean(functional.relu(messages[others] + self.listen(h)), covers[others])
            h = self.gru(h[None], message[None])[0]
        return torch.addcmul(mean, heard.to(mean.dtype), self.out(h), out=out)

    def fuse_all(
        self, maps: Tensor, covers: Tensor, codes: Tensor | None, world: Tensor, ego: Tensor
    ) -> Float[Tensor, "B C H W"]:
        assert codes is not None
        mean, (state, messages) = average_all(maps, covers), codes[world].split(self.width, dim=2)
        heard = covers.sum(1) > 1
        first = torch.where(ego[:, None, None, None], state[:, 0], average_all(state, covers))
        senders = covers.clone()
        senders[ego, 0] = 0  # the ego sends itself nothing
        h = functional.relu(first)
        for _ in range(ROUNDS):
            heard_of = functional.relu(messages + self.listen(h)[:, None])
            h = self.gru(h, average_all(heard_of, senders))
        return mean + heard[:, None] * self.out(h)


class ConvGru(nn.Module):
    """A gated recurrent unit (Cho et al., 2014; its reset gate behind the product, as in torch's own) over maps.

    Its convolutions are 3x3: one of the state, one of the message, each depthwise and then pointwise.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.state, self.message = (
            nn.Sequential(nn.Conv2d(width, width, 3, padding=1, groups=width, bias=False), Pointwise(width, 3 * width))
            for _ in range(2)
        )

    def forward(self, h: Float[Tensor, "B D H W"], message: Float[Tensor, "B D H W"]) -> Float[Tensor, "B D H W"]:
        width = h.shape[1]
        (gates, new_state), (others, new_message) = (
            out.split([2 * width, width], dim=1) for out in (self.state(h), self.message(message))
        )
        reset, update = (gates + others).sigmoid().chunk(2, dim=1)
        new = torch.addcmul(new_message, reset, new_state).tanh()
        return torch.lerp(h, new, update)


def _mean(maps: Float[Tensor, "M D H W"], covers: Float[Tensor, "M 1 H W"]) -> Float[Tensor, "D H W"]:
    return (maps * covers).sum(0) / covers.sum(0).clamp(min=1)
