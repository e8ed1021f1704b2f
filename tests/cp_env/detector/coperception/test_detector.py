"""coperception's detector: the same numbers as its layer sequence gives, for the ego's fused view of any group.

No weights of theirs are here: random ones in their format serve.
"""

from __future__ import annotations

import copy
import math
import pickle
from collections.abc import Sequence

import numpy as np
import pytest
import torch
from torch import Tensor

from cp_env.detector.coperception import FUSIONS, grid, load_checkpoint
from cp_env.types import Sweep
from tests.helpers.coperception_views import (
    AGENTS,
    EVERYONE,
    FIRST,
    GROUPS,
    LATTICE_POSES,
    POSES,
    detector,
    ours,
    state,
    voxels,
)
from tests.reference import coperception as twin


def matrices(poses: Sequence[Sequence[float]]) -> Tensor:
    """[i, j]: takes points of agent j to agent i; agents stand at `poses` in the first one's frame."""
    world_T = []
    for x, y, yaw in poses:
        matrix = np.eye(4)
        matrix[:2, :2] = [[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]]
        matrix[:2, 3] = x, y
        world_T.append(matrix)
    return torch.tensor(np.array([[np.linalg.inv(a) @ b for b in world_T] for a in world_T]))


@torch.no_grad()
def theirs(
    fusion: str, poses: Sequence[Sequence[float]], mirrored: bool = True, model: str | None = None
) -> tuple[Tensor, Tensor]:
    """The same of their layer sequence; `model` names the weights where the fusion does not."""
    bev = voxels()[: len(poses)].float()
    scores, codes = twin.forward(state(model or fusion), fusion, bev, matrices(poses), mirrored=mirrored, egos=1)
    odds = (scores[..., 1] - scores[..., 0]).reshape(1, 256, 256, 6)
    return odds.permute(0, 3, 1, 2), codes.permute(0, 3, 4, 1, 2)


def agree(a: tuple[Tensor, Tensor], b: tuple[Tensor, Tensor]) -> None:
    for one, other in zip(a, b, strict=True):
        assert torch.allclose(one, other, rtol=1e-5, atol=1e-5), float((one - other).abs().max())
    assert float(a[0].std()) > 0.1, "a network that says the same everywhere shows nothing"


@pytest.mark.parametrize("fusion", FUSIONS)
def test_the_fused_view_has_their_numbers(fusion: str) -> None:
    agree(ours(detector(fusion), POSES), theirs(fusion, POSES))


def test_so_has_the_way_their_code_warped_before() -> None:
    """Sampled twice, and V2VNet's kernels on maps that are mirrored along one axis only."""
    agree(ours(detector("v2vnet", "rotate-translate"), POSES), theirs("v2vnet", POSES, mirrored=False))


def test_so_have_poses_on_the_lattice() -> None:
    """Where our warp copies whole cells instead of sampling."""
    agree(ours(detector("max"), LATTICE_POSES), theirs("max", LATTICE_POSES))


def test_the_model_that_shares_nothing_is_a_group_of_the_ego() -> None:
    agree(ours(detector("none"), POSES, torch.tensor([[True, False, False]])), theirs("mean", POSES[:1], model="none"))


def test_a_checkpoint_file_gives_the_same_detector(tmp_path: object) -> None:
    """As they write it: `module.` before every key, an epoch, an optimiser; halves that nothing uses."""
    path = f"{tmp_path}/epoch_100.pth"
    twin.save(state("mean"), path, optimizer_state_dict={"state": {}, "param_groups": [{"lr": 0.001}]}, loss=0.3)
    loaded = load_checkpoint(path)
    assert loaded.digest == detector().digest != detector("max").digest
    warped_otherwise = load_checkpoint(path, resampling="rotate-translate")
    assert loaded.digest != warped_otherwise.digest
    assert loaded.maps_digest == detector("max").maps_digest != warped_otherwise.maps_digest
    assert not any(parameter.requires_grad for parameter in loaded.parameters()) and not loaded.training


# -- what goes in ----------------------------------------------------------------------------------------------------


def test_shared_maps_lie_in_our_layout() -> None:
    """What stands in the east is in the last columns: a return 30 m east changes them and no others."""
    bare, east = np.zeros((0, 3), np.float32), np.array([[30.0, -20.0, 1.0]], np.float32)
    maps = detector().encode([Sweep(points, np.array([0.0, 0.0, 1.9])) for points in (bare, east)])
    rows, columns = (maps[1] - maps[0]).abs().amax(0).nonzero().unbind(1)
    assert columns.min() >= 26 and columns.max() == 31 and rows.max() <= 10


# -- groups -----------------------------------------------------------------------------------------------------------


def test_views_do_not_depend_on_others_of_their_batch(received: Tensor) -> None:
    model = detector().with_ego_context(grid.pack(voxels()[:2]))
    world, coverage, groups = torch.tensor([0, 1]), torch.ones(2, AGENTS, 32, 32), GROUPS[1:3]
    together = model.perceive(received, coverage, world, groups)
    for row in range(len(groups)):
        alone = model.perceive(received, coverage, world[row : row + 1], groups[row : row + 1])
        assert torch.allclose(together.logits[row], alone.logits[0], atol=1e-4)
    with pytest.raises(ValueError, match=r"rows \[1\] of groups hold none"):
        model.perceive(received, coverage, world[:2], torch.tensor([[True, False, False], [False] * 3]))


def test_the_ego_needs_its_own_sweep(received: Tensor) -> None:
    with pytest.raises(ValueError, match=r"detector.with_ego_context\(ego_context\)"):
        detector().perceive(received, torch.ones(2, AGENTS, 32, 32), FIRST, EVERYONE)


def test_what_is_remembered_is_only_speed(received: Tensor) -> None:
    """Another ego's frame in between, a copy, a pickle: the same view."""
    model = detector().with_ego_context(grid.pack(voxels()[:2]))
    first = model.raw(received, FIRST, EVERYONE)[0]
    assert not torch.allclose(model.raw(received, FIRST + 1, EVERYONE)[0], first, atol=1e-2)
    other = pickle.loads(pickle.dumps(model))
    assert len(model._skips) >= 2 and not other._skips and not copy.deepcopy(model)._skips
    assert torch.equal(other.raw(received, FIRST, EVERYONE)[0], first)


def test_all_boxes_are_kept_where_theirs_are_wanted() -> None:
    """The ego's own box, and one whose centre lies at 32.3 m, are dropped unless they are asked for."""
    ours_only, every = detector("mean"), copy.copy(detector("mean"))
    every.all_boxes = True
    boxes = np.array([[0.2, 0.1, 4.5, 2.0, 0.1], [10.0, 5.0, 4.5, 2.0, 0.4], [32.3, 0.0, 4.5, 2.0, 0.0]])
    scores, own = np.array([0.9, 0.8, 0.75]), np.zeros(2)
    assert ours_only._boxes(boxes, scores, own).scores.tolist() == pytest.approx([0.8])
    assert every._boxes(boxes, scores, own).scores.tolist() == pytest.approx([0.9, 0.8, 0.75])
    assert ours_only.digest != every.digest and ours_only.maps_digest == every.maps_digest
