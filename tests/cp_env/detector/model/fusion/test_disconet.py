"""DiscoNet: its weights share out each cell."""

from __future__ import annotations

import torch

from cp_env.detector.model.fusion.base import Sent
from cp_env.detector.model.fusion.disconet import DiscoNet
from tests.helpers.received_maps import DETECTORS, GROUPS, WORLD, N, Situation


def test_disconets_weights_share_out_each_cell(situation: Situation) -> None:
    fuser = DETECTORS["disconet"].fuser
    assert isinstance(fuser, DiscoNet)
    maps, masks = (tensor[1] for tensor in situation)
    members = [Sent(one, mask, fuser.describe(one)) for one, mask in zip(maps, masks, strict=True)]
    for ego, group in ((True, members), (False, members[1:])):
        weights = fuser.weights(group, ego)
        covers = torch.stack([one.covers for one in group])
        assert (weights[covers == 0] == 0).all() and (weights[covers > 0] > 0).all()
        torch.testing.assert_close(weights.sum(0), (covers.sum(0) > 0).float())
        assert weights.std(0).max() > 0.01  # lively, not the mean


def test_disconet_by_its_definition(situation: Situation) -> None:
    """One cell: softmax over members of three layers on (centre, member), written out."""
    fuser = DETECTORS["disconet"].fuser
    assert isinstance(fuser, DiscoNet)
    received, coverage = situation
    row, col = 16, 16
    members = [i for i in range(N) if coverage[0, i, row, col] > 0]
    assert len(members) > 1
    cell = received[0, :, :, row, col]
    scores = []
    for i in members:
        first = fuser.code.weight[: fuser.width] @ cell[0] + fuser.code.bias[: fuser.width]
        first = first + fuser.code.weight[fuser.width :] @ cell[i] + fuser.code.bias[fuser.width :]
        second = (fuser.hidden.weight @ first.relu() + fuser.hidden.bias).relu()
        scores.append(fuser.score.weight @ second + fuser.score.bias)
    expected = (torch.cat(scores).softmax(0)[:, None] * cell[members]).sum(0)
    fused = DETECTORS["disconet"].fuse(received, coverage, WORLD[:1], GROUPS[:1])[0, :, row, col]
    torch.testing.assert_close(fused, expected, atol=1e-4, rtol=1e-4)
