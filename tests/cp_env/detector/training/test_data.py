"""Training data: sweeps, mirrors, batches and targets."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from cp_env.detector.model import bev
from cp_env.detector.training import data
from cp_env.detector.training.data import RasterisedScene, draw, prepare
from cp_env.scenes.errors import BrokenData
from cp_env.types import Sweep
from tests.helpers.tiny_training import _overlap
from tests.helpers.toy_scenes import ToySource


def test_a_rasterised_scene_is_its_sweeps(scenes: list[RasterisedScene]) -> None:
    source = ToySource(n_frames=3)
    scene = source.load("toy-1")
    rasterised = scenes[1]
    assert rasterised.n_frames == 2  # frames 0 and 2
    sweeps = source.sweeps(scene, [2])[0]
    assert torch.equal(bev.unpack(rasterised.packed[1]), bev.rasterise(sweeps))
    assert np.array_equal(rasterised.hits[1], [sweep.hits for sweep in sweeps])
    assert rasterised.boxes[1, :, :2] == pytest.approx(scene.pose[2, :, :2])


def test_scenes_are_rasterised_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = ToySource(n_frames=1)
    first = prepare(source, tmp_path)
    monkeypatch.setattr(ToySource, "sweeps", lambda *_: pytest.fail("cast again"))
    again = prepare(source, tmp_path)
    assert np.array_equal(first[0].packed, again[0].packed)


@pytest.mark.parametrize("kind", ["npy", "npz"])
def test_a_broken_file_of_the_cache_is_named_with_the_way_out(tmp_path: Path, kind: str) -> None:
    source = ToySource(n_frames=1)
    prepare(source, tmp_path)
    (file,) = tmp_path.glob(f"*/toy-0.{kind}")
    file.write_bytes(file.read_bytes()[:-30])
    with pytest.raises(BrokenData, match=rf"toy-0\.{kind}: .*; delete .*, what it holds is made again"):
        prepare(source, tmp_path)


@pytest.mark.parametrize("mirror", [np.array([a, b, c], dtype=bool) for a in (0, 1) for b in (0, 1) for c in (0, 1)])
def test_mirrors_move_grids_points_and_boxes_alike(mirror: np.ndarray) -> None:
    rng = np.random.default_rng(5)
    points = rng.uniform(-32, 32, (400, 3)).astype(np.float32)
    points[:, 2] = np.abs(points[:, 2]) / 10
    moved = points.copy()
    moved[:, :2] = data._mirror_points(points[:, :2], mirror)
    grid, expected = (bev.rasterise([Sweep(p, np.zeros(3))]) for p in (points, moved))
    assert torch.equal(data._mirror_grids(grid, mirror), expected)
    box = np.array([[3.0, -7.0, 4.5, 1.8, 0.3]], dtype=np.float32)
    front = box[:, :2] + np.stack([np.cos(box[:, 4]), np.sin(box[:, 4])], axis=-1)
    turned = data._mirror_boxes(box, mirror)
    expected_front = data._mirror_points(front, mirror)
    ahead = turned[:, :2] + np.stack([np.cos(turned[:, 4]), np.sin(turned[:, 4])], axis=-1)
    assert ahead == pytest.approx(expected_front, abs=1e-5)
    assert turned[:, 2:4] == pytest.approx(box[:, 2:4])


def test_batches_follow_the_seed_and_hold_sound_groups(scenes: list[RasterisedScene]) -> None:
    def at(seed: int) -> data.Batch:
        return draw(scenes, np.random.default_rng(seed), frames=2, egos=2, views=3)

    one, same, other = at(4), at(4), at(5)
    assert torch.equal(one.occupancy, same.occupancy) and torch.equal(one.groups, same.groups)
    assert not torch.equal(one.ego_T_sender, other.ego_T_sender)
    assert one.groups.any(dim=1).all() and one.groups[0].sum() == 5
    assert len(one.world) == len(one.groups) == len(one.targets.heat) == 12
    assert int(one.agent.max()) < len(one.occupancy)


def test_the_truth_lies_where_the_sensors_hit(scenes: list[RasterisedScene]) -> None:
    """Returns above ground near most target centres: grids, offsets and boxes share one frame, mirrored or not."""
    near = []
    for seed in range(6):
        batch = draw(scenes, np.random.default_rng(seed), frames=1, egos=1, views=2)
        tall = batch.occupancy[:, 1:].amax(dim=1).float()
        tall = torch.nn.functional.max_pool2d(tall, 4)  # to cells of 1 m
        shift = (batch.ego_T_sender[0, :, :2]).round().int().tolist()
        union = torch.zeros(64, 64)
        for sweep, (x, y) in zip(batch.agent[0].tolist(), shift, strict=True):
            source, target = _overlap(tall[sweep], union, x, y)
            target.copy_(torch.maximum(target, source))
        centres = (batch.targets.heat[0] == 1).nonzero()
        close = torch.nn.functional.max_pool2d(union[None], 5, stride=1, padding=2)[0]
        near.extend(close[row, col].item() for row, col in centres.tolist())
    assert np.mean(near) > 0.95


def test_the_ego_comes_first(scenes: list[RasterisedScene]) -> None:
    for seed in range(4):
        batch = draw(scenes, np.random.default_rng(seed), frames=2, egos=2, views=3)
        assert not batch.ego_T_sender[:, 0].any()
        without = batch.groups.reshape(len(batch.agent), 3, -1)[:, -1, 0]
        assert not without.any()  # the last view of each lacks the ego
