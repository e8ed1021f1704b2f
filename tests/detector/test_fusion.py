"""f_F: against a slow twin, and the laws that verification rests on."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from cp_env.detector import Detector
from tests.reference import fusion as slow

E, N, C, SIZE = 2, 4, 128, 32


@pytest.fixture(scope="module")
def detector() -> Detector:
    torch.manual_seed(0)  # torch's layers draw their first weights from nowhere else
    return Detector().freeze()


@pytest.fixture(scope="module")
def situation(detector: Detector) -> tuple[torch.Tensor, torch.Tensor]:
    """Received maps and coverage of E worlds that differ; world 1's last sender is out of range."""
    generator = torch.Generator().manual_seed(3)
    poses = torch.zeros(E, N, 3)
    poses[:, 1:, :2] = 40 * (torch.rand(E, N - 1, 2, generator=generator) - 0.5)
    poses[1, 3, 0] = 80.0
    maps = torch.rand(E, N, C, SIZE, SIZE, generator=generator)
    return detector.warp(maps, poses), detector.coverage(poses)


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


def test_slow_twin(detector: Detector, situation: tuple[torch.Tensor, torch.Tensor]) -> None:
    received, coverage = situation
    few = received[:, :, :3]
    expected = slow.mean(few.numpy(), coverage.numpy(), WORLD.numpy(), GROUPS.numpy())
    assert np.allclose(detector.fuse(few, coverage, WORLD, GROUPS), expected, atol=1e-6)


def test_by_hand(detector: Detector) -> None:
    # two senders show 1 and 3; the second covers the eastern half only
    received = torch.tensor([1.0, 3.0]).reshape(1, 2, 1, 1, 1).expand(1, 2, C, SIZE, SIZE)
    coverage = torch.ones(1, 2, SIZE, SIZE)
    coverage[0, 1, :, :16] = 0
    groups = torch.tensor([[True, True], [True, False], [False, True]])
    fused = detector.fuse(received, coverage, torch.zeros(3, dtype=torch.long), groups)
    assert (fused[0, :, :, :16] == 1).all() and (fused[0, :, :, 16:] == 2).all()
    assert (fused[1] == 1).all()
    assert (fused[2, :, :, :16] == 0).all() and (fused[2, :, :, 16:] == 3).all()


def test_a_vehicle_outside_the_group_changes_nothing(
    detector: Detector, situation: tuple[torch.Tensor, torch.Tensor]
) -> None:
    received, coverage = situation
    changed = received.clone()
    changed[:, 1] = 1e6
    outside = ~GROUPS[:, 1]
    before = detector.fuse(received, coverage, WORLD, GROUPS)
    after = detector.fuse(changed, coverage, WORLD, GROUPS)
    assert torch.equal(before[outside], after[outside])
    assert not torch.equal(before[0], after[0])


def test_the_order_of_senders_does_not_matter(detector: Detector, situation: tuple[torch.Tensor, torch.Tensor]) -> None:
    received, coverage = situation
    order = torch.tensor([2, 0, 3, 1])
    turned = detector.fuse(received[:, order], coverage[:, order], WORLD, GROUPS[:, order])
    assert torch.allclose(turned, detector.fuse(received, coverage, WORLD, GROUPS), atol=1e-5)


def test_a_batch_is_its_rows(detector: Detector, situation: tuple[torch.Tensor, torch.Tensor]) -> None:
    received, coverage = situation
    together = detector.perceive(received, coverage, WORLD, GROUPS)
    fused = detector.fuse(received, coverage, WORLD, GROUPS)
    for b, e in enumerate(WORLD.tolist()):
        alone = received[e : e + 1], coverage[e : e + 1], torch.zeros(1, dtype=torch.long), GROUPS[b : b + 1]
        assert torch.equal(fused[b], detector.fuse(*alone)[0])
        view = detector.perceive(*alone)
        assert torch.allclose(together.logits[b], view.logits[0], atol=1e-4)
        assert torch.allclose(together.boxes[b], view.boxes[0], atol=1e-4)


def test_gradient_reaches_members_only(detector: Detector, situation: tuple[torch.Tensor, torch.Tensor]) -> None:
    received, coverage = (tensor.clone() for tensor in situation)
    received.requires_grad_()
    dense = detector.perceive(received, coverage, WORLD[2:3], GROUPS[2:3])  # world 1, senders 1 and 2
    (dense.logits.sum() + dense.boxes.sum()).backward()
    assert received.grad is not None
    reached = received.grad.abs().amax(dim=(2, 3, 4)) > 0
    assert reached.tolist() == [[False] * 4, [False, True, True, False]]


def test_an_empty_group_is_refused(detector: Detector, situation: tuple[torch.Tensor, torch.Tensor]) -> None:
    received, coverage = situation
    groups = GROUPS.clone()
    groups[2] = False
    with pytest.raises(ValueError, match=r"at least one vehicle: rows \[2\]"):
        detector.fuse(received, coverage, WORLD, groups)


def test_unknown_fusion_lists_the_known() -> None:
    with pytest.raises(ValueError, match=r"mean.*'median'"):
        Detector(fusion="median")
