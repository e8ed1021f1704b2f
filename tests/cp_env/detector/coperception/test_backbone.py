"""The backbone: two layers in one."""

from __future__ import annotations

import torch

from cp_env.detector.coperception.backbone import Doubled


def test_doubling_then_convolving_in_one() -> None:
    generator = torch.Generator().manual_seed(0)
    weight, bias = torch.randn(5, 3, 3, 3, generator=generator), torch.randn(5, generator=generator)
    x = torch.randn(2, 3, 6, 4, generator=generator)
    direct = torch.nn.functional.conv2d(torch.nn.functional.interpolate(x, scale_factor=2.0), weight, bias, padding=1)
    assert torch.allclose(Doubled(weight, bias)(x), direct, atol=1e-5)
