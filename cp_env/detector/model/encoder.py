"""f_E: a vehicle's occupancy grid becomes the feature map it shares."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils.fusion import fuse_conv_bn_eval

STRIDE = 4  # grid cells a side that become one cell of the first feature map: 0.25 m -> 1 m


class Conv(nn.Module):
    """Convolution, batch normalisation, ReLU; the middle one melts into the first once training is over."""

    def __init__(
        self, channels_in: int, channels_out: int, kernel: int = 3, stride: int = 1, padding: int | None = None
    ) -> None:
        super().__init__()
        padding = kernel // 2 if padding is None else padding
        self.conv = nn.Conv2d(channels_in, channels_out, kernel, stride, padding, bias=False)
        nn.init.kaiming_normal_(self.conv.weight, nonlinearity="relu")  # random weights too give features of about 1
        self.norm: nn.Module = nn.BatchNorm2d(channels_out)

    def forward(self, x: Float[Tensor, "B I H W"]) -> Float[Tensor, "B O h w"]:
        out: Tensor = functional.relu(self.norm(self.conv(x)), inplace=True)
        return out

    def fold(self) -> None:
        """Put the (eval-mode) normalisation into the convolution: the same function, one pass less."""
        if isinstance(self.norm, nn.BatchNorm2d):
            self.conv = fuse_conv_bn_eval(self.conv, self.norm)
            self.norm = nn.Identity()


class Encoder(nn.Module):
    """Occupancy [B, Z, 256, 256] at 0.25 m to shared maps [B, C, 32, 32] at 2 m, which are nowhere negative."""

    def __init__(self, slices: int, channels: int, width: int = 32) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            Conv(slices, width, kernel=STRIDE, stride=STRIDE, padding=0),
            Conv(width, width),
            Conv(width, 2 * width, stride=2),
            Conv(2 * width, 2 * width),
            Conv(2 * width, channels),
        )

    def forward(self, occupancy: Float[Tensor, "B Z R R"]) -> Float[Tensor, "B C H W"]:
        features: Tensor = self.layers(occupancy)
        return features
