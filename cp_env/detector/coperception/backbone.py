"""coperception's U-net, cut where maps are shared: what an ego computes once a frame, and what each view costs.

Its decoder joins the fused map with layers of the ego's own sweep, which are never sent. A convolution of two maps side
by side is the sum of two convolutions, so the ego's part of the sum is made once a frame (`Decoder.skips`) and a view
pays for its own part only. Where that part is a map doubled in size (nearest), four small kernels on the small map do
what one does on the large, with less than half the products (`Doubled`).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from cp_env.detector.coperception.checkpoint import Weights, layer
from cp_env.detector.coperception.grid import SLICES

CHANNELS = 256
"""Of the shared map, 32 x 32 cells of 2 m."""


@dataclass(frozen=True, eq=False)
class Layers:
    """What the encoder makes of a sweep; only `shared` is sent."""

    full: Float[Tensor, "B 32 256 256"]
    half: Float[Tensor, "B 64 128 128"]
    quarter: Float[Tensor, "B 128 64 64"]
    shared: Float[Tensor, "B 256 32 32"]
    deepest: Float[Tensor, "B 512 16 16"]


@dataclass(frozen=True, eq=False)
class Skips:
    """The ego's own part of the sums in the decoder's four stages, before their ReLU."""

    five: Float[Tensor, "B 256 32 32"]
    six: Float[Tensor, "B 128 64 64"]
    seven: Float[Tensor, "B 64 128 128"]
    eight: Float[Tensor, "B 32 256 256"]


class Encoder(nn.Module):
    """Voxels to layers: pairs of 3x3 convolutions, the first of each pair of stride 2."""

    def __init__(self, weights: Weights, half: str) -> None:
        super().__init__()

        def stage(name: str, norm: str, into: int, out: int, stride: int, volume: str | None = None) -> nn.Sequential:
            convs = [
                layer(*weights.conv(f"{half}.{name}_1", f"{half}.{norm}_1", (out, into, 3, 3)), stride),
                layer(*weights.conv(f"{half}.{name}_2", f"{half}.{norm}_2", (out, out, 3, 3))),
            ]
            if volume is not None:  # over one moment in time: a product of channels
                prefix = f"{half}.{volume}"
                convs.append(layer(*weights.conv(f"{prefix}.conv3d", f"{prefix}.bn3d", (out, out, 1, 1, 1))))
            return _rectified(*convs)

        self.pre = stage("conv_pre", "bn_pre", SLICES, 32, 1)
        self.one = stage("conv1", "bn1", 32, 64, 2, "conv3d_1")
        self.two = stage("conv2", "bn2", 64, 128, 2, "conv3d_2")
        self.three = stage("conv3", "bn3", 128, CHANNELS, 2)
        self.four = stage("conv4", "bn4", CHANNELS, 512, 2)
        self.narrow = nn.Sequential()
        squeeze = f"{half}.com_compresser.weight"
        if squeeze in weights and weights.shape(squeeze)[0] != CHANNELS:  # trained to send fewer channels
            sent = weights.shape(squeeze)[0]
            self.narrow = _rectified(
                layer(*weights.conv(f"{half}.com_compresser", f"{half}.bn_compress", (sent, CHANNELS, 1, 1))),
                layer(*weights.conv(f"{half}.com_decompresser", f"{half}.bn_decompress", (CHANNELS, sent, 1, 1))),
            )

    def shared(self, grid: Float[Tensor, "B 13 256 256"]) -> Float[Tensor, "B 256 32 32"]:
        """The map that is sent, and nothing else."""
        sent: Tensor = self.narrow(self.three(self.two(self.one(self.pre(grid)))))
        return sent

    def forward(self, grid: Float[Tensor, "B 13 256 256"]) -> Layers:
        full = self.pre(grid)
        half = self.one(full)
        quarter = self.two(half)
        eighth = self.three(quarter)
        return Layers(full, half, quarter, self.narrow(eighth), self.four(eighth))


class Decoder(nn.Module):
    """Four stages, each a join of what is below (doubled) with the ego's layer of that size, and a second convolution.

    The shared map joins what is deepest; that one is the ego's own, made of its unfused map, as in coperception.
    """

    def __init__(self, weights: Weights, half: str) -> None:
        super().__init__()

        def join(number: int, below: int, own: int, out: int) -> tuple[Tensor, Tensor, Tensor]:
            """Weights on what is below and on the ego's own layer, and the bias."""
            name, shape = f"{half}.conv{number}_1", (out, below + own, 3, 3)
            weight, bias = weights.conv(name, f"{half}.bn{number}_1", shape)
            return weight[:, :below], weight[:, below:], bias

        def second(number: int, width: int) -> nn.Conv2d:
            return layer(*weights.conv(f"{half}.conv{number}_2", f"{half}.bn{number}_2", (width, width, 3, 3)))

        deepest, shared, bias = join(5, 512, CHANNELS, 256)
        self.own5, self.join5 = Doubled(deepest, bias), layer(shared, torch.zeros(256))
        self.second5, self.second6, self.second7, self.second8 = (
            second(number, width) for number, width in ((5, 256), (6, 128), (7, 64), (8, 32))
        )
        below, own, bias = join(6, 256, 128, 128)
        self.join6, self.own6 = Doubled(below), layer(own, bias)
        below, own, bias = join(7, 128, 64, 64)
        self.join7, self.own7 = Doubled(below), layer(own, bias)
        below, own, bias = join(8, 64, 32, 32)
        self.join8, self.own8 = Doubled(below), layer(own, bias)

    def skips(self, own: Layers) -> Skips:
        """The ego's part, once a frame."""
        return Skips(self.own5(own.deepest), self.own6(own.quarter), self.own7(own.half), self.own8(own.full))

    def forward(self, fused: Float[Tensor, "B 256 32 32"], skips: Skips) -> Float[Tensor, "B 32 256 256"]:
        x = functional.relu(self.second5(functional.relu(self.join5(fused) + skips.five)))
        x = functional.relu(self.second6(functional.relu(self.join6(x) + skips.six)))
        x = functional.relu(self.second7(functional.relu(self.join7(x) + skips.seven)))
        out: Tensor = functional.relu(self.second8(functional.relu(self.join8(x) + skips.eight)))
        return out


class Doubled(nn.Module):
    """A 3x3 convolution of a map doubled in size: of the three rows a kernel touches there, two are one row here.

    Which two depends on whether the output row is even or odd, and so for columns: four kernels of 2x2, whose outputs
    interleave.
    """

    def __init__(self, weight: Float[Tensor, "O I 3 3"], bias: Float[Tensor, " O"] | None = None) -> None:
        super().__init__()
        out = len(weight)
        rows = torch.stack([_merged(weight, 2, odd) for odd in (False, True)], dim=1)  # O 2 I 2 3
        both = torch.stack([_merged(rows, 4, odd) for odd in (False, True)], dim=2)  # O 2 2 I 2 2
        self.weight = nn.Parameter(both.flatten(0, 2).contiguous())
        self.bias = nn.Parameter((torch.zeros(out) if bias is None else bias).repeat_interleave(4))

    def forward(self, x: Float[Tensor, "B I h w"]) -> Float[Tensor, "B O H W"]:
        height, width = x.shape[-2:]
        out = functional.conv2d(x, self.weight, self.bias, padding=1).unflatten(1, (-1, 2, 2))
        phases = [out[:, :, r, c, r : r + height, c : c + width] for r in (0, 1) for c in (0, 1)]
        return functional.pixel_shuffle(torch.stack(phases, dim=2).flatten(1, 2), 2)


def _merged(weight: Tensor, axis: int, odd: bool) -> Tensor:
    """Three taps along `axis` as the two that act on the small map, for even or odd outputs."""
    first, middle, last = weight.unbind(axis)
    return torch.stack([first + middle, last] if odd else [first, middle + last], axis)


def _rectified(*convs: nn.Conv2d) -> nn.Sequential:
    return nn.Sequential(*(part for conv in convs for part in (conv, nn.ReLU(inplace=True))))
