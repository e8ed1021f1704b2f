"""f_F: laws over the family, slow twins, and the laws that verification rests on."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from cp_env.detector import Detector
from cp_env.detector.model.fusion.disconet import DiscoNet
from cp_env.detector.model.fusion.v2vnet import V2VNet
from tests.helpers.received_maps import DETECTORS, GROUPS, SIZE, WORLD, C, N, Situation

ALONE = [3, 4, 5]


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


def test_an_empty_group_is_refused(situation: Situation) -> None:
    received, coverage = situation
    groups = GROUPS.clone()
    groups[2] = False
    with pytest.raises(ValueError, match=r"at least one vehicle: rows \[2\]"):
        DETECTORS["mean"].fuse(received, coverage, WORLD, groups)


def test_unknown_fusion_lists_the_known() -> None:
    with pytest.raises(ValueError, match=r"mean, max, sum, v2vnet, disconet, not 'median'"):
        Detector(fusion="median")


def test_a_view_is_the_same_whether_its_gradient_is_recorded_or_not(detector: Detector, situation: Situation) -> None:
    """Without gradients a view is written in place."""
    received, coverage = situation
    recorded = detector.fuse(received.clone().requires_grad_(), coverage, WORLD, GROUPS)
    with torch.inference_mode():
        assert torch.equal(detector.fuse(received, coverage, WORLD, GROUPS), recorded.detach())
    assert recorded.requires_grad


def test_all_groups_at_once_are_each_group_by_itself(detector: Detector, situation: Situation) -> None:
    """What a GPU computes, beside the loop of the CPU."""
    received, coverage = situation
    with torch.no_grad():
        expected = detector.fuser(received, coverage, WORLD, GROUPS)
        torch.testing.assert_close(
            detector.fuser.together(received, coverage, WORLD, GROUPS), expected, atol=1e-4, rtol=1e-4
        )
