"""Laws of coperception's five fusions."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from cp_env.detector.coperception import FUSIONS, grid
from tests.helpers.coperception_views import AGENTS, EVERYONE, FIRST, GROUPS, POSES, detector, voxels


@pytest.fixture(scope="module")
def small(received: Tensor) -> Tensor:
    """A part of them: fusions work at any map size."""
    return received[..., 12:20, 10:20].contiguous()


@pytest.mark.parametrize("fusion", FUSIONS)
def test_fusions_are_lawful(fusion: str, small: Tensor) -> None:
    """A vehicle alone is its own map (the law of groups of one); outsiders do not matter, nor who is second or third,
    nor which views are asked with it; maps of zeros count in a mean."""
    fuse, received = detector(fusion).fuser, small
    world = torch.tensor([0, 1, 0, 1, 0])
    fused = fuse(received, world, GROUPS)
    for row in range(len(GROUPS)):
        alone = fuse(received, world[row : row + 1], GROUPS[row : row + 1])[0]
        assert torch.allclose(fused[row], alone, atol=1e-5)
    assert torch.equal(fused[1], received[1, 0]) and torch.equal(fused[3], received[1, 2])
    perturbed = received.clone()
    perturbed[:, 1] += 5
    assert torch.equal(fuse(perturbed, world, GROUPS)[4], fused[4])
    assert not torch.allclose(fuse(perturbed, world, GROUPS)[0], fused[0], atol=1e-2)
    swapped = fuse(received[:, [0, 2, 1]], world, GROUPS[:, [0, 2, 1]])
    assert torch.allclose(swapped, fused, atol=1e-5)


@pytest.mark.parametrize("fusion", ["max", "disconet"])
def test_a_perturbation_can_be_improved_by_its_gradient(fusion: str) -> None:
    """Through warp, fusion, decoder and the reduction to cells: a small step along the gradient gains what it says."""
    model = detector(fusion).with_ego_context(grid.pack(voxels()[:1]))
    maps = model.encode_grids(voxels())
    poses = torch.tensor(POSES)
    delta = torch.zeros_like(maps[1]).requires_grad_()

    def objective(delta: Tensor) -> Tensor:
        sent = torch.cat([maps[:1], maps[1:2] + delta, maps[2:]])
        dense = model.perceive(model.warp(sent, poses)[None], torch.ones(1, AGENTS, 32, 32), FIRST, EVERYONE)
        return torch.stack([dense.logits.mean(), dense.boxes.mean()])

    of_logits, of_boxes = objective(delta)
    (drift,) = torch.autograd.grad(of_boxes, delta, retain_graph=True)
    assert bool(torch.isfinite(drift).all()) and bool(drift.any()), (
        "which anchor is best may jump, what it says may not"
    )
    (gradient,) = torch.autograd.grad(of_logits, delta)
    step = 0.5 * gradient / gradient.norm()
    with torch.no_grad():
        gained = objective(step)[0] - of_logits
    assert float(gained) == pytest.approx(float((step * gradient).sum()), rel=0.2)
    assert all(parameter.grad is None for parameter in model.parameters())
