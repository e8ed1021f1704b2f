"""coperception's detector: the same numbers as its layer sequence gives, for the ego's fused view of any group.

No weights of theirs are here: random ones in their format serve.
"""

from __future__ import annotations

import copy
import math
import pickle
from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest
import torch
from torch import Tensor

from cp_env.detector.coperception import FUSIONS, CoperceptionDetector, grid, heads, load_checkpoint
from cp_env.detector.coperception.backbone import Doubled
from cp_env.detector.coperception.checkpoint import Weights
from cp_env.geometry.boxes import rotated_iou
from cp_env.types import Sweep
from tests.reference import coperception as twin

AGENTS = 3
EVERYONE = torch.ones(1, AGENTS, dtype=torch.bool)
FIRST = torch.zeros(1, dtype=torch.long)
POSES = ((0.0, 0.0, 0.0), (7.3, -4.1, 0.7), (-12.0, 5.0, -2.0))
LATTICE_POSES = ((0.0, 0.0, 0.0), (6.0, -4.0, 0.0), (-12.0, 22.0, 0.0))


@cache
def state(fusion: str) -> twin.State:
    """A model's random weights; those that only share maps differ in what they fuse by alone."""
    base = twin.random_state("none" if fusion == "none" else "mean", rarity=1.0)
    if fusion not in ("v2vnet", "disconet"):
        return base
    return {**twin.fusion_state(fusion), **base}


@cache
def detector(fusion: str = "mean", resampling: str = "affine") -> CoperceptionDetector:
    named = fusion if fusion in FUSIONS else "mean"
    return CoperceptionDetector(Weights(state(fusion), "a checkpoint"), named, 3, resampling)


@cache
def voxels(agents: int = AGENTS) -> Tensor:
    generator = torch.Generator().manual_seed(1)
    return (torch.rand(agents, 13, 256, 256, generator=generator) < 0.02).to(torch.uint8)


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
def ours(
    eyes: CoperceptionDetector, poses: Sequence[Sequence[float]], groups: Tensor = EVERYONE
) -> tuple[Tensor, Tensor]:
    """Log-odds and codes of the views of the first agent, in coperception's layout."""
    bev = voxels()[: len(poses)]
    received = eyes.warp(eyes.encode_grids(bev), torch.tensor(poses))[None]
    return eyes.beside(grid.pack(bev[:1])).raw(received, torch.zeros(len(groups), dtype=torch.long), groups)


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


def sweep(height: float) -> Sweep:
    rng = np.random.default_rng(0)
    points = rng.uniform([-40, -40, -1], [40, 40, 8], size=(4000, 3)).astype(np.float32)
    return Sweep(points, np.array([101.3, -57.9, height]))


@pytest.mark.parametrize(("height", "low"), [(1.9, -3.0), (6.0, -8.0)])
def test_voxels_as_their_preprocessing_makes_them(height: float, low: float) -> None:
    """Indices by floor, from the lowest voxel on; then a turn by three quarters. The road-side unit looks lower."""
    one = sweep(height)
    points = one.points.astype(np.float64) + np.array([101.3 - 102.0, -57.9 + 58.0, -height])
    inside = (np.abs(points[:, :2]) < 32).all(1) & (points[:, 2] > low) & (points[:, 2] < low + 5)
    indices = np.floor(points[inside] / [0.25, 0.25, 0.4]).astype(int)
    indices -= np.floor(np.array([-32, -32, low]) / [0.25, 0.25, 0.4]).astype(int)
    volume = np.zeros((256, 256, 13), dtype=bool)
    volume[tuple(indices.T)] = True
    wanted = torch.from_numpy(np.rot90(volume, 3).transpose(2, 0, 1).copy()).to(torch.uint8)
    made = grid.rasterise([one])[0]
    assert int((made != wanted).sum()) <= 2, "single precision may round a point over an edge"
    assert int(made.sum()) > 500 and torch.equal(grid.from_voxels(indices), wanted)


def test_packing_loses_nothing() -> None:
    packed = grid.pack(voxels())
    assert packed.shape == (AGENTS, 13, 256, 32) and torch.equal(grid.unpack(packed), voxels())


def test_shared_maps_lie_in_our_layout() -> None:
    """What stands in the east is in the last columns: a return 30 m east changes them and no others."""
    bare, east = np.zeros((0, 3), np.float32), np.array([[30.0, -20.0, 1.0]], np.float32)
    maps = detector().encode([Sweep(points, np.array([0.0, 0.0, 1.9])) for points in (bare, east)])
    rows, columns = (maps[1] - maps[0]).abs().amax(0).nonzero().unbind(1)
    assert columns.min() >= 26 and columns.max() == 31 and rows.max() <= 10


# -- what comes out ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def view() -> tuple[Tensor, Tensor]:
    return ours(detector(), POSES)


def test_boxes_are_theirs(view: tuple[Tensor, Tensor]) -> None:
    """Score and outline of every box above 0.7, after their suppression of polygons."""
    odds, codes = view
    threshold = odds.flatten().topk(400).values[-1] - math.log(0.7 / 0.3)
    odds = odds - threshold  # 400 anchors are sure
    scores = torch.stack([torch.zeros_like(odds), odds], dim=-1)[0].permute(1, 2, 0, 3).reshape(-1, 2)
    outlines, sure = twin.detections(scores, codes[0].permute(2, 3, 0, 1))
    found = heads.best_anchors(odds, codes, 0.05, 4096)
    kept = detector().detect(heads.Anchored(odds[:, 0], codes[:, 0], *found))[0].above(0.7)
    centre = outlines.mean(1) * [-1, 1]
    mine = (np.abs(centre) <= 32).all(1) & (np.linalg.norm(centre, axis=1) > 1.5)
    assert len(sure) > 20 and len(kept.scores) == mine.sum()
    assert np.allclose(kept.scores, sure[mine], atol=1e-6)
    edges = outlines[mine][:, [1, 2]] - outlines[mine][:, [0, 1]]
    (width, length), (dx, dy) = np.linalg.norm(edges, axis=2).T, edges[:, 1].T
    boxes = np.stack([*centre[mine].T, length, width, np.arctan2(dy, -dx)], axis=1)
    assert np.allclose(rotated_iou(kept.boxes, boxes), 1, atol=1e-3)


def test_a_cell_of_a_metre_says_what_its_best_anchor_does(view: tuple[Tensor, Tensor]) -> None:
    odds, codes = view
    logits, boxes = heads.reduce(odds, codes)
    rng = np.random.default_rng(0)
    for row, column in rng.integers(0, 64, size=(12, 2)):
        block = odds[0, :, 4 * row : 4 * row + 4, 4 * column : 4 * column + 4]
        anchor, r, c = (int(i) for i in np.unravel_index(int(block.argmax()), block.shape))
        assert logits[0, row, 63 - column] == block.max()
        code = codes[0, anchor, :, 4 * row + r, 4 * column + c].double().numpy()
        outline = twin.corners(code, 4 * row + r, 4 * column + c, anchor) * [-1, 1]
        dx, dy, log_length, log_width, sin, cos = boxes[0, :, row, 63 - column].double().tolist()
        centre = outline.mean(0)
        assert np.allclose([31.5 - column + dx, row - 31.5 + dy], centre, atol=1e-4)
        along = outline[1] - outline[2]
        assert np.allclose(math.exp(log_length), np.linalg.norm(along), atol=1e-4)
        assert np.allclose(math.exp(log_width), np.linalg.norm(outline[0] - outline[1]), atol=1e-4)
        yaw = math.atan2(along[1], along[0])
        assert np.allclose([sin, cos], [math.sin(2 * yaw), math.cos(2 * yaw)], atol=1e-4)


def test_doubling_then_convolving_in_one() -> None:
    generator = torch.Generator().manual_seed(0)
    weight, bias = torch.randn(5, 3, 3, 3, generator=generator), torch.randn(5, generator=generator)
    x = torch.randn(2, 3, 6, 4, generator=generator)
    direct = torch.nn.functional.conv2d(torch.nn.functional.interpolate(x, scale_factor=2.0), weight, bias, padding=1)
    assert torch.allclose(Doubled(weight, bias)(x), direct, atol=1e-5)


# -- groups -----------------------------------------------------------------------------------------------------------

GROUPS = torch.tensor([[1, 1, 1], [1, 0, 0], [0, 1, 1], [0, 0, 1], [1, 0, 1]], dtype=torch.bool)


@pytest.fixture(scope="module")
def received() -> Tensor:
    """Two worlds of three maps."""
    maps = detector().encode_grids(voxels())
    one = detector().warp(maps, torch.tensor(POSES))
    return torch.stack([one, detector().warp(maps.flip(0), torch.tensor(LATTICE_POSES))])


@pytest.fixture(scope="module")
def small(received: Tensor) -> Tensor:
    """A part of them: fusions do not mind how large a map is."""
    return received[..., 12:20, 10:20].contiguous()


@pytest.mark.parametrize("fusion", FUSIONS)
def test_fusions_are_lawful(fusion: str, small: Tensor) -> None:
    """A vehicle alone is its own map (the law of groups of one); outsiders do not matter, nor who is second or third,
    nor which views are asked beside; maps of zeros count in a mean."""
    fuse, received = detector(fusion).fuser, small
    world = torch.tensor([0, 1, 0, 1, 0])
    fused = fuse(received, world, GROUPS)
    for row in range(len(GROUPS)):
        alone = fuse(received, world[row : row + 1], GROUPS[row : row + 1])[0]
        assert torch.allclose(fused[row], alone, atol=1e-5)
    assert torch.equal(fused[1], received[1, 0]) and torch.equal(fused[3], received[1, 2])
    lying = received.clone()
    lying[:, 1] += 5
    assert torch.equal(fuse(lying, world, GROUPS)[4], fused[4])
    assert not torch.allclose(fuse(lying, world, GROUPS)[0], fused[0], atol=1e-2)
    swapped = fuse(received[:, [0, 2, 1]], world, GROUPS[:, [0, 2, 1]])
    assert torch.allclose(swapped, fused, atol=1e-5)


def test_views_do_not_depend_on_those_asked_beside(received: Tensor) -> None:
    eyes = detector().beside(grid.pack(voxels()[:2]))
    world, coverage, groups = torch.tensor([0, 1]), torch.ones(2, AGENTS, 32, 32), GROUPS[1:3]
    together = eyes.perceive(received, coverage, world, groups)
    for row in range(len(groups)):
        alone = eyes.perceive(received, coverage, world[row : row + 1], groups[row : row + 1])
        assert torch.allclose(together.logits[row], alone.logits[0], atol=1e-4)
    with pytest.raises(ValueError, match=r"rows \[1\] of groups hold none"):
        eyes.perceive(received, coverage, world[:2], torch.tensor([[True, False, False], [False] * 3]))


def test_the_ego_needs_its_own_sweep(received: Tensor) -> None:
    with pytest.raises(ValueError, match=r"detector.beside\(kept\)"):
        detector().perceive(received, torch.ones(2, AGENTS, 32, 32), FIRST, EVERYONE)


def test_what_is_remembered_is_only_speed(received: Tensor) -> None:
    """Another ego's frame in between, a copy, a pickle: the same view."""
    eyes = detector().beside(grid.pack(voxels()[:2]))
    first = eyes.raw(received, FIRST, EVERYONE)[0]
    assert not torch.allclose(eyes.raw(received, FIRST + 1, EVERYONE)[0], first, atol=1e-2)
    other = pickle.loads(pickle.dumps(eyes))
    assert len(eyes._skips) >= 2 and not other._skips and not copy.deepcopy(eyes)._skips
    assert torch.equal(other.raw(received, FIRST, EVERYONE)[0], first)


@pytest.mark.parametrize("fusion", ["max", "disconet"])
def test_a_lie_can_be_improved_by_its_gradient(fusion: str) -> None:
    """Through warp, fusion, decoder and the reduction to cells: a small step along the gradient gains what it says."""
    eyes = detector(fusion).beside(grid.pack(voxels()[:1]))
    maps = eyes.encode_grids(voxels())
    poses = torch.tensor(POSES)
    delta = torch.zeros_like(maps[1]).requires_grad_()

    def objective(lie: Tensor) -> Tensor:
        sent = torch.cat([maps[:1], maps[1:2] + lie, maps[2:]])
        dense = eyes.perceive(eyes.warp(sent, poses)[None], torch.ones(1, AGENTS, 32, 32), FIRST, EVERYONE)
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
    assert all(parameter.grad is None for parameter in eyes.parameters())
