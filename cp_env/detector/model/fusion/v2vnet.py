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

from cp_env.detector.model.fusion.base import Fusion, Pointwise, Sent, average

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

    def describe(self, one: Float[Tensor, "C H W"]) -> Float[Tensor, "D H W"]:
        code: Tensor = self.code(one)
        return code

    def fuse(self, members: Sequence[Sent], ego: bool) -> Float[Tensor, "C H W"]:
        mean = average([one.map for one in members], [one.covers for one in members])
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
            h = self.gru(h, _mean(functional.relu(messages[others] + self.listen(h)), covers[others]))
        return mean + heard * self.out(h)


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

    def forward(self, h: Float[Tensor, "D H W"], message: Float[Tensor, "D H W"]) -> Float[Tensor, "D H W"]:
        from_state, from_message = self.state(h[None])[0], self.message(message[None])[0]
        width = len(h)
        reset, update = (from_state[: 2 * width] + from_message[: 2 * width]).sigmoid().chunk(2)
        new = torch.addcmul(from_message[2 * width :], reset, from_state[2 * width :]).tanh()
        return torch.lerp(h, new, update)


def _mean(maps: Float[Tensor, "M D H W"], covers: Float[Tensor, "M 1 H W"]) -> Float[Tensor, "D H W"]:
    return (maps * covers).sum(0) / covers.sum(0).clamp(min=1)
