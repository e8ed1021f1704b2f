"""f_F: laws over the family, slow twins, and the laws that verification rests on."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from cp_env.detector import Detector
from cp_env.detector.model.fusion import FUSIONS
from cp_env.detector.model.fusion.base import Sent
from cp_env.detector.model.fusion.disconet import DiscoNet
from cp_env.detector.model.fusion.v2vnet import ConvGru, V2VNet
from tests.reference import fusion as slow

E, N, C, SIZE = 2, 4, 16, 32
Situation = tuple[torch.Tensor, torch.Tensor]


def lively(name: str) -> Detector:
    """A detector whose fusion's last layers, zero before training, are not."""
    with torch.random.fork_rng():
        torch.manual_seed(0)  # torch's layers draw their first weights from nowhere else
        detector = Detector(fusion=name, channels=C)
        with torch.no_grad():
            for parameter in detector.fuser.parameters():
                if not parameter.any():
                    parameter.normal_(std=0.5)
    return detector.freeze()


DETECTORS = {name: lively(name) for name in FUSIONS}


@pytest.fixture(params=FUSIONS)
def detector(request: pytest.FixtureRequest) -> Detector:
    return DETECTORS[request.param]


@pytest.fixture(scope="module")
def situation() -> Situation:
    """Received maps and coverage of E worlds that differ; world 1's last sender is out of range."""
    generator = torch.Generator().manual_seed(3)
    poses = torch.zeros(E, N, 3)
    poses[:, 1:, :2] = 40 * (torch.rand(E, N - 1, 2, generator=generator) - 0.5)
    poses[1, 3, 0] = 80.0
    maps = torch.rand(E, N, C, SIZE, SIZE, generator=generator)
    return DETECTORS["mean"].warp(maps, poses), DETECTORS["mean"].coverage(poses)


WORLD = torch.tensor([0, 1, 1, 0, 1, 0])
GROUPS = torch.tensor(
    [
        [True, True, True, True],
        [True, True, True, True],
        [False, True, True, False],  # without the ego
        [False, False, True, False],  # of one
        [False, False, False, True],  # of one that covers nothing
        [True, False, False, False],
    ]
)
ALONE = [3, 4, 5]


@pytest.mark.parametrize("name", ["mean", "max", "sum"])
def test_slow_twin(name: str, situation: Situation) -> None:
    received, coverage = situation
    few = received[:, :, :3]
    expected = slow.FUSIONS[name](few.numpy(), coverage.numpy(), WORLD.numpy(), GROUPS.numpy())
    assert np.allclose(DETECTORS[name].fuse(few, coverage, WORLD, GROUPS), expected, atol=1e-6)


@pytest.mark.parametrize(("name", "both"), [("mean", 2), ("max", 3), ("sum", 4)])
def test_by_hand(name: str, both: int) -> None:
    # two senders show 1 and 3; the second covers the eastern half only
    received = torch.tensor([1.0, 3.0]).reshape(1, 2, 1, 1, 1).expand(1, 2, C, SIZE, SIZE)
    coverage = torch.ones(1, 2, SIZE, SIZE)
    coverage[0, 1, :, :16] = 0
    groups = torch.tensor([[True, True], [True, False], [False, True]])
    fused = DETECTORS[name].fuse(received, coverage, torch.zeros(3, dtype=torch.long), groups)
    assert (fused[0, :, :, :16] == 1).all() and (fused[0, :, :, 16:] == both).all()
    assert (fused[1] == 1).all()
    assert (fused[2, :, :, :16] == 0).all() and (fused[2, :, :, 16:] == 3).all()


def test_the_maximum_of_lies_below_zero_is_below_zero() -> None:
    received = torch.tensor([-2.0, -1.0]).reshape(1, 2, 1, 1, 1).expand(1, 2, C, SIZE, SIZE)
    coverage = torch.ones(1, 2, SIZE, SIZE)
    coverage[0, :, 0] = 0
    groups, world = torch.ones(1, 2, dtype=torch.bool), torch.zeros(1, dtype=torch.long)
    fused = DETECTORS["max"].fuse(received, coverage, world, groups)
    assert (fused[:, :, 0] == 0).all() and (fused[:, :, 1:] == -1).all()


def test_a_vehicle_outside_the_group_changes_nothing(detector: Detector, situation: Situation) -> None:
    received, coverage = situation
    changed = received.clone()
    changed[:, 1] = 1e6
    outside = ~GROUPS[:, 1]
    before = detector.fuse(received, coverage, WORLD, GROUPS)
    after = detector.fuse(changed, coverage, WORLD, GROUPS)
    assert torch.equal(before[outside], after[outside])
    assert not torch.equal(before[0], after[0])


def test_a_map_counts_for_nothing_where_it_does_not_reach(detector: Detector, situation: Situation) -> None:
    """What is written into cells that the sender's map does not cover is read by nobody."""
    received, coverage = situation
    written = received + 100.0 * (coverage == 0)[:, :, None]
    assert torch.equal(
        detector.fuse(written, coverage, WORLD, GROUPS), detector.fuse(received, coverage, WORLD, GROUPS)
    )


def test_a_cell_that_nobody_covers_is_zero(detector: Detector, situation: Situation) -> None:
    received, coverage = situation
    fused = detector.fuse(received, coverage, WORLD, GROUPS)
    blank = torch.einsum("bn,bnhw->bhw", GROUPS.float(), coverage[WORLD]) == 0
    assert blank.any() and blank[4].all()
    assert not fused.movedim(1, -1)[blank].any()


@given(order=st.permutations(range(1, N)))
@settings(max_examples=6)
def test_the_order_of_collaborators_does_not_matter(order: list[int], situation: Situation) -> None:
    """The ego stays number 0: it is the centre of a group that it is in."""
    received, coverage = situation
    new = torch.tensor([0, *order])
    for detector in DETECTORS.values():
        turned = detector.fuse(received[:, new], coverage[:, new], WORLD, GROUPS[:, new])
        assert torch.allclose(turned, detector.fuse(received, coverage, WORLD, GROUPS), atol=1e-4)


@pytest.mark.parametrize("name", ["v2vnet", "disconet"])
def test_it_matters_who_is_the_centre(name: str, situation: Situation) -> None:
    received, coverage = situation
    new = torch.tensor([1, 0, 2, 3])
    everyone = torch.ones(1, N, dtype=torch.bool)
    world = torch.zeros(1, dtype=torch.long)
    fused = DETECTORS[name].fuse(received, coverage, world, everyone)
    assert not torch.allclose(
        DETECTORS[name].fuse(received[:, new], coverage[:, new], world, everyone), fused, atol=1e-3
    )


def test_a_group_of_one_is_that_vehicles_own_map(detector: Detector, situation: Situation) -> None:
    received, coverage = situation
    fused = detector.fuse(received, coverage, WORLD[ALONE], GROUPS[ALONE])
    own = received[WORLD[ALONE], GROUPS[ALONE].int().argmax(1)]
    covers = coverage[WORLD[ALONE], GROUPS[ALONE].int().argmax(1)]
    assert torch.equal(fused, own * covers[:, None])
    assert torch.equal(
        detector.perceive(received, coverage, WORLD[5:], GROUPS[5:]).logits, detector.decode(own[2:]).logits
    )


def test_a_batch_is_its_rows(detector: Detector, situation: Situation) -> None:
    received, coverage = situation
    together = detector.perceive(received, coverage, WORLD, GROUPS)
    fused = detector.fuse(received, coverage, WORLD, GROUPS)
    for b, e in enumerate(WORLD.tolist()):
        alone = received[e : e + 1], coverage[e : e + 1], torch.zeros(1, dtype=torch.long), GROUPS[b : b + 1]
        assert torch.equal(fused[b], detector.fuse(*alone)[0])
        view = detector.perceive(*alone)
        assert torch.allclose(together.logits[b], view.logits[0], atol=1e-4)
        assert torch.allclose(together.boxes[b], view.boxes[0], atol=1e-4)


def test_no_rows_are_no_views(detector: Detector, situation: Situation) -> None:
    received, coverage = situation
    assert detector.fuse(received, coverage, WORLD[:0], GROUPS[:0]).shape == (0, C, SIZE, SIZE)


def test_gradient_reaches_members_only(detector: Detector, situation: Situation) -> None:
    received, coverage = (tensor.clone() for tensor in situation)
    received.requires_grad_()
    dense = detector.perceive(received, coverage, WORLD[2:3], GROUPS[2:3])  # world 1, senders 1 and 2
    (dense.logits.sum() + dense.boxes.sum()).backward()
    assert received.grad is not None and torch.isfinite(received.grad).all()
    reached = received.grad.abs().amax(dim=(2, 3, 4)) > 0
    assert reached.tolist() == [[False] * 4, [False, True, True, False]]


def test_gradient_stays_finite_where_nobody_is_heard(detector: Detector, situation: Situation) -> None:
    received, coverage = (tensor.clone() for tensor in situation)
    received.requires_grad_()
    detector.fuse(received, coverage, WORLD[4:5], GROUPS[4:5]).sum().backward()
    assert received.grad is not None and not received.grad.any()


def test_untrained_heads_are_the_mean(situation: Situation) -> None:
    """So training starts from the mean's decoder, not from nothing."""
    expected = DETECTORS["mean"].fuse(*situation, WORLD, GROUPS)
    for kind in (V2VNet, DiscoNet):
        torch.testing.assert_close(kind(C)(*situation, WORLD, GROUPS), expected, atol=1e-5, rtol=1e-5)


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
    torch.testing.assert_close(ours(h, message), expected)


def test_v2vnet_by_its_definition(situation: Situation) -> None:
    """Three rounds for the ego among two others, written out over whole maps that all reach everywhere."""
    fuser = DETECTORS["v2vnet"].fuser
    assert isinstance(fuser, V2VNet)
    maps = situation[0][0, :3] + 0.1
    own, told = fuser.code(maps).split(fuser.width, dim=1)
    h = own[0].relu()
    for _ in range(3):
        listened = fuser.listen(h)
        h = fuser.gru(h, ((told[1] + listened).relu() + (told[2] + listened).relu()) / 2)
    expected = maps.mean(0) + fuser.out(h)
    everyone, world = torch.ones(1, 3, dtype=torch.bool), torch.zeros(1, dtype=torch.long)
    fused = fuser(maps[None], torch.ones(1, 3, SIZE, SIZE), world, everyone)[0]
    torch.testing.assert_close(fused, expected, atol=1e-4, rtol=1e-4)


def test_an_empty_group_is_refused(situation: Situation) -> None:
    received, coverage = situation
    groups = GROUPS.clone()
    groups[2] = False
    with pytest.raises(ValueError, match=r"at least one vehicle: rows \[2\]"):
        DETECTORS["mean"].fuse(received, coverage, WORLD, groups)


def test_unknown_fusion_lists_the_known() -> None:
    with pytest.raises(ValueError, match=r"mean, max, sum, v2vnet, disconet, not 'median'"):
        Detector(fusion="median")
