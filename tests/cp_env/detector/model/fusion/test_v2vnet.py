"""V2VNet and its convolutional GRU, by their definitions."""

from __future__ import annotations

import torch

from cp_env.detector.model.fusion.v2vnet import ConvGru, V2VNet
from tests.helpers.received_maps import DETECTORS, SIZE, Situation


def test_the_convolutional_gru_is_a_gru_in_every_cell() -> None:
    """With kernels that see their own cell only, it is torch's GRUCell, whose update gate keeps where ours renews."""
    torch.manual_seed(0)
    width = 3
    ours, theirs = ConvGru(width), torch.nn.GRUCell(width, width)
    sign = torch.ones(3 * width)
    sign[width : 2 * width] = -1
    with torch.no_grad():
        for (spread, mix), weight, bias in (
            (ours.message, theirs.weight_ih, theirs.bias_ih),
            (ours.state, theirs.weight_hh, theirs.bias_hh),
        ):
            spread.weight.zero_()[:, :, 1, 1] = 1
            weight.copy_(sign[:, None] * mix.weight)
            bias.copy_(sign * mix.bias)
    h, message = torch.rand(2, width, 4, 5)
    expected = theirs(message.flatten(1).T, h.flatten(1).T).T.reshape(width, 4, 5)
    torch.testing.assert_close(ours(h[None], message[None])[0], expected)


def test_v2vnet_by_its_definition(situation: Situation) -> None:
    """Three rounds for the ego among two others, written out over whole maps that all reach everywhere."""
    fuser = DETECTORS["v2vnet"].fuser
    assert isinstance(fuser, V2VNet)
    maps = situation[0][0, :3] + 0.1
    own, told = fuser.code(maps).split(fuser.width, dim=1)
    h = own[0].relu()
    for _ in range(3):
        listened = fuser.listen(h)
        message = ((told[1] + listened).relu() + (told[2] + listened).relu()) / 2
        h = fuser.gru(h[None], message[None])[0]
    expected = maps.mean(0) + fuser.out(h)
    everyone, world = torch.ones(1, 3, dtype=torch.bool), torch.zeros(1, dtype=torch.long)
    fused = fuser(maps[None], torch.ones(1, 3, SIZE, SIZE), world, everyone)[0]
    torch.testing.assert_close(fused, expected, atol=1e-4, rtol=1e-4)
