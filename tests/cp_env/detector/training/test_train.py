"""Training: the data is what it says, the loss falls, a killed run ends where it would have."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from cp_env.detector import Detector
from cp_env.detector.model import bev
from cp_env.detector.model.fusion import FUSIONS
from cp_env.detector.model.weights import read_detector, save_detector
from cp_env.detector.training import data
from cp_env.detector.training.data import Footage, draw, prepare
from cp_env.detector.training.distillation import divergence, early_fusion, features, teach
from cp_env.detector.training.train import Args, batch_loss, load, main, train
from cp_env.types import Sweep
from tests.helpers.toy_scenes import ToySource

TINY = Args(frames=1, egos=1, views=2, agents=2, threads=1, checkpoint_every=2, learning_rate=2e-3)


@pytest.fixture(scope="module")
def footage(tmp_path_factory: pytest.TempPathFactory) -> list[Footage]:
    return prepare(ToySource(n_frames=3), tmp_path_factory.mktemp("footage"), stride=2)


def test_footage_is_the_sweeps(footage: list[Footage]) -> None:
    source = ToySource(n_frames=3)
    scene = source.load("toy-1")
    film = footage[1]
    assert film.n_frames == 2  # frames 0 and 2
    sweeps = source.sweeps(scene, [2])[0]
    assert torch.equal(bev.unpack(film.packed[1]), bev.rasterise(sweeps))
    assert np.array_equal(film.hits[1], [sweep.hits for sweep in sweeps])
    assert film.boxes[1, :, :2] == pytest.approx(scene.pose[2, :, :2])


def test_footage_is_cast_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = ToySource(n_frames=1)
    first = prepare(source, tmp_path)
    monkeypatch.setattr(ToySource, "sweeps", lambda *_: pytest.fail("cast again"))
    again = prepare(source, tmp_path)
    assert np.array_equal(first[0].packed, again[0].packed)


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


def test_batches_follow_the_seed_and_hold_sound_groups(footage: list[Footage]) -> None:
    def at(seed: int) -> data.Batch:
        return draw(footage, np.random.default_rng(seed), frames=2, egos=2, views=3)

    one, same, other = at(4), at(4), at(5)
    assert torch.equal(one.occupancy, same.occupancy) and torch.equal(one.groups, same.groups)
    assert not torch.equal(one.ego_T_sender, other.ego_T_sender)
    assert one.groups.any(dim=1).all() and one.groups[0].sum() == 5
    assert len(one.world) == len(one.groups) == len(one.targets.heat) == 12
    assert int(one.agent.max()) < len(one.occupancy)


def test_the_truth_lies_where_the_sensors_hit(footage: list[Footage]) -> None:
    """Returns above ground near most target centres: grids, offsets and boxes share one frame, mirrored or not."""
    near = []
    for seed in range(6):
        batch = draw(footage, np.random.default_rng(seed), frames=1, egos=1, views=2)
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


def _overlap(sender: torch.Tensor, ego: torch.Tensor, x: int, y: int) -> tuple[torch.Tensor, torch.Tensor]:
    """The part of the sender's map on the ego's, in both, for a shift by whole cells."""
    size = len(ego)
    rows, cols = slice(max(y, 0), size + min(y, 0)), slice(max(x, 0), size + min(x, 0))
    back_rows, back_cols = slice(max(-y, 0), size + min(-y, 0)), slice(max(-x, 0), size + min(-x, 0))
    return sender[back_rows, back_cols], ego[rows, cols]


def test_the_loss_falls(footage: list[Footage], tmp_path: Path) -> None:
    """One view, seen again and again."""
    args = replace(TINY, out=tmp_path, steps=25, checkpoint_every=25)
    from cp_env.detector.training import train as module

    losses = []
    with pytest.MonkeyPatch.context() as patch:
        batch = draw(footage, np.random.default_rng(0), frames=1, egos=1, views=2, agents=2)
        patch.setattr(module, "draw", lambda *_, **__: batch)
        real = module.batch_loss
        patch.setattr(module, "batch_loss", lambda *a, **k: losses.append(real(*a, **k)) or losses[-1])
        train(args, footage)
    assert losses[-1] < 0.4 * losses[0]


def test_a_killed_run_ends_where_it_would_have(footage: list[Footage], tmp_path: Path) -> None:
    whole = train(replace(TINY, out=tmp_path / "whole", steps=4), footage)

    class Killed(Exception):
        pass

    from cp_env.detector.training import train as module

    def dies(*args: object, **kwargs: object) -> data.Batch:
        calls.append(1)
        if len(calls) == 4:
            raise Killed
        return draw(*args, **kwargs)  # type: ignore[arg-type]

    calls: list[int] = []
    with pytest.MonkeyPatch.context() as patch, pytest.raises(Killed):
        patch.setattr(module, "draw", dies)
        train(replace(TINY, out=tmp_path / "killed", steps=4), footage)
    again = train(replace(TINY, out=tmp_path / "killed", steps=4), footage)
    assert again.digest == whole.digest


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Weights to start heads from."""
    path = tmp_path_factory.mktemp("weights") / "mean.safetensors"
    with torch.random.fork_rng():
        torch.manual_seed(2)
        save_detector(Detector(), path)
    return path


def test_kept_maps_are_the_encoders(known: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    args = replace(TINY, fusion="max", encoder=known, cache=tmp_path, stride=2)
    source = ToySource(n_frames=2)
    footage = load(args, source)
    detector = read_detector(known).eval()
    batch = draw(footage, np.random.default_rng(0), frames=1, egos=2, views=2, agents=4)
    assert batch.maps is not None and len(batch.maps) == len(batch.occupancy)
    with torch.no_grad():
        torch.testing.assert_close(batch.maps, detector.encode_grids(batch.occupancy), atol=2e-3, rtol=2e-3)
    monkeypatch.setattr(Detector, "encode_grids", lambda *_: pytest.fail("encoded again"))
    assert np.array_equal(load(args, source)[0].maps, footage[0].maps)
    other = Detector()
    assert other.maps_digest != detector.maps_digest


def test_the_ego_comes_first(footage: list[Footage]) -> None:
    for seed in range(4):
        batch = draw(footage, np.random.default_rng(seed), frames=2, egos=2, views=3)
        assert not batch.ego_T_sender[:, 0].any()
        without = batch.groups.reshape(len(batch.agent), 3, -1)[:, -1, 0]
        assert not without.any()  # the last view of each lacks the ego


@pytest.mark.parametrize("name", FUSIONS)
def test_heads_learn_behind_a_fixed_encoder(name: str, known: Path, footage: list[Footage], tmp_path: Path) -> None:
    before = read_detector(known)
    args = replace(TINY, fusion=name, encoder=known, out=tmp_path, steps=3)
    trained = train(args, footage)
    assert trained.fusion == name and trained.maps_digest == before.maps_digest
    assert not torch.equal(trained.decoder.stem.conv.weight, before.decoder.stem.conv.weight)
    fresh = FUSIONS[name](trained.channels).state_dict()
    learned = trained.fuser.state_dict()
    assert learned.keys() == fresh.keys()
    assert all((value - fresh[key]).any() for key, value in learned.items())
    save_detector(trained, tmp_path / f"{name}.safetensors")
    assert read_detector(tmp_path / f"{name}.safetensors").fusion == name


def test_early_fusion_is_every_return_in_one_grid(footage: list[Footage]) -> None:
    batch = draw(footage, np.random.default_rng(1), frames=1, egos=1, views=3, agents=3)
    grids = early_fusion(batch, 32.0)
    cells = (batch.ego_T_sender[0, :, :2] / bev.BEV.cell).round().int().tolist()
    for row, group in zip(grids, batch.groups, strict=True):
        union = torch.zeros_like(batch.occupancy[0])
        for sweep, (x, y), member in zip(batch.agent[0].tolist(), cells, group.tolist(), strict=True):
            if member:
                for layer, joint in zip(batch.occupancy[sweep], union, strict=True):
                    source, target = _overlap(layer, joint, x, y)
                    target.copy_(torch.maximum(target, source))
        assert torch.equal(row, union.float()) and row.any()


def test_distillation_by_hand_and_at_its_floor(footage: list[Footage]) -> None:
    ours = torch.tensor([0.0, 0.0]).reshape(1, 2, 1, 1)
    theirs = torch.tensor([np.log(3.0), 0.0]).reshape(1, 2, 1, 1).float()  # softmax 3/4, 1/4 against 1/2, 1/2
    by_hand = 0.75 * np.log(1.5) + 0.25 * np.log(0.5)
    assert divergence([ours, ours], [theirs, ours]).item() == pytest.approx(by_hand, rel=1e-5)
    torch.manual_seed(0)
    teacher = Detector().eval().requires_grad_(False)
    batch = draw(footage, np.random.default_rng(0), frames=1, egos=1, views=2, agents=2)
    taught = teach(teacher, batch)
    same, seen = features(teacher, teacher.encode_grids(early_fusion(batch, 32.0)))
    assert divergence(seen, taught).item() == pytest.approx(0, abs=1e-6)
    assert len(taught) == 3 and same.logits.shape == (2, 64, 64)


def test_a_student_is_drawn_to_its_teacher(known: Path, footage: list[Footage]) -> None:
    batch = draw(footage, np.random.default_rng(0), frames=1, egos=1, views=2, agents=3)
    teacher = read_detector(known).eval().requires_grad_(False)
    student = Detector(fusion="disconet")
    alone = batch_loss(student, batch)
    taught = batch_loss(student, batch, teacher=teacher, weight=2.0)
    assert taught > alone
    taught.backward()
    assert all(parameter.grad is not None for parameter in student.fuser.parameters())
    assert all(parameter.grad is None for parameter in teacher.parameters())


def test_the_command_trains_a_teacher_and_its_student(
    known: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from cp_env.detector.training import train as module

    monkeypatch.setattr(module, "open_source", lambda _: ToySource(n_frames=1))
    tiny = replace(TINY, steps=1, cache=tmp_path / "cache")
    main(replace(tiny, early=True, init=known, out=tmp_path))
    teacher = tmp_path / "early.safetensors"
    student = replace(tiny, fusion="disconet", encoder=known, teacher=teacher, out=tmp_path / "student")
    main(student)
    assert read_detector(student.out / "disconet.safetensors").fusion == "disconet"


def test_what_does_not_go_together_is_refused(known: Path, footage: list[Footage], tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="choose one"):
        Args(encoder=known, init=known)
    with pytest.raises(ValueError, match="leave --fusion at mean, not max"):
        Args(early=True, fusion="max")
    with pytest.raises(ValueError, match="fuses by mean, not sum"):
        train(replace(TINY, init=known, fusion="sum", out=tmp_path), footage)
