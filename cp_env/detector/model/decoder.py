"""f_D: a fused map becomes scores and boxes for every cell of 1 m, and those become detections."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from cp_env.detector.model.encoder import Conv

BOX_CHANNELS = 6
WHOLE = 64
"""Peaks of a view are padded to a multiple of this: the end of an array that fills no vector of the processor may be
rounded otherwise than its middle, so a view's last bits would depend on its place in the batch."""
RARE = -4.0  # logit a cell starts from: few cells hold a vehicle's centre


@dataclass(frozen=True, eq=False)
class Dense:
    """What the decoder says of every cell of 1 m, in the ego's grid frame.

    boxes: dx, dy (m, from the cell's centre to the vehicle's), log length, log width (m), sin 2yaw, cos 2yaw: seen from
    above, front and back of a box cannot be told apart.
    """

    logits: Float[Tensor, "B h w"]
    boxes: Float[Tensor, "B 6 h w"]

    @property
    def scores(self) -> Float[Tensor, "B h w"]:
        """Probability that a vehicle's centre lies in the cell."""
        return self.logits.sigmoid()


class Decoder(nn.Module):
    """Fused maps [B, C, H, W] to `Dense` at twice the resolution, through a small U-net.

    The maps are taken in any precision, computed with in that of the weights, and given back in single precision.
    """

    def __init__(self, channels: int, width: int = 64, deep: int = 96) -> None:
        super().__init__()
        self.stem = Conv(channels, width, kernel=1)
        self.down = nn.Sequential(Conv(width, deep, stride=2), Conv(deep, deep))
        self.up = nn.Conv2d(deep, width, kernel_size=1)
        self.top = Conv(width, width)
        self.head = nn.Conv2d(width, 4 * (1 + BOX_CHANNELS), kernel_size=1)
        nn.init.constant_(self.head.bias[:4], RARE)  # type: ignore[index]

    def forward(self, fused: Float[Tensor, "B C H W"]) -> Dense:
        fine = self._pointwise(fused.to(self.up.weight.dtype))
        coarse = functional.interpolate(self.up(self.down(fine)), scale_factor=2.0, mode="nearest")
        cells = self.head(self.top(fine + coarse)).float()  # here it lies in one piece
        out = functional.pixel_shuffle(cells, 2)
        return Dense(out[:, 0], out[:, 1:])

    def _pointwise(self, fused: Float[Tensor, "B C H W"]) -> Float[Tensor, "B D H W"]:
        """The stem; once folded a matrix product, which leaves the channels last and is faster than a convolution."""
        if self.stem.conv.bias is None:
            out: Tensor = self.stem(fused)
            return out
        weight = self.stem.conv.weight.flatten(start_dim=1)
        pixels = fused.flatten(start_dim=2).transpose(1, 2)
        out = functional.relu(functional.linear(pixels, weight, self.stem.conv.bias))
        return out.transpose(1, 2).unflatten(2, fused.shape[2:])


def cell_centres(size: int, extent: float, like: Tensor) -> Float[Tensor, " size"]:
    """x of a map's columns (and y of its rows), m."""
    return (torch.arange(size, dtype=like.dtype, device=like.device) + 0.5) * (2 * extent / size) - extent


def highest_neighbour(x: Float[Tensor, "B h w"]) -> Float[Tensor, "B h w"]:
    """The largest entry of each cell's 3x3 neighbourhood."""
    return _highest(_highest(x, -1), -2)


def _highest(x: Float[Tensor, "B h w"], axis: int) -> Float[Tensor, "B h w"]:
    """The largest of each entry and its neighbours along an axis: what a pooling layer gives, many times as fast."""
    size, highest = x.shape[axis], x.clone()
    for to, of in ((0, 1), (1, 0)):
        place = highest.narrow(axis, to, size - 1)
        torch.maximum(place, x.narrow(axis, of, size - 1), out=place)
    return highest


def peaks(dense: Dense, floor: float, extent: float, most: int) -> tuple[Float[Tensor, "B K"], Float[Tensor, "B K 5"]]:
    """Scores and boxes of the highest local maxima of each view, best first; scores of 0 fill up to K.

    A peak is a cell that no other of its 3x3 neighbourhood exceeds, with a score of at least `floor`.
    """
    logits = dense.logits.detach()
    size = logits.shape[-1]
    highest = highest_neighbour(logits)
    lowest = torch.tensor(floor, dtype=logits.dtype).logit().item()
    candidates = torch.where((logits == highest) & (logits >= lowest), logits, -torch.inf).flatten(start_dim=1)
    n = min(most, candidates.shape[1])
    best, index = (functional.pad(one, (0, -n % WHOLE)) for one in candidates.topk(n, dim=1))
    code = dense.boxes.detach().flatten(start_dim=2).gather(2, index[:, None].expand(-1, BOX_CHANNELS, -1))
    centre = cell_centres(size, extent, logits)
    x = centre[index % size] + code[:, 0]
    y = centre[torch.div(index, size, rounding_mode="floor")] + code[:, 1]
    yaw = torch.atan2(code[:, 4], code[:, 5]) / 2
    boxes = torch.stack([x, y, code[:, 2].clamp(-2, 4).exp(), code[:, 3].clamp(-2, 4).exp(), yaw], dim=-1)
    return best.sigmoid()[:, :n], boxes[:, :n]
