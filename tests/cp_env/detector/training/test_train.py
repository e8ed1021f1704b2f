"""Training: the data is what it says, the loss falls, a killed run ends where it would have."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from cp_env.detector import Detector
from cp_env.detector.model.fusion import FUSIONS
from cp_env.detector.model.weights import read_detector, save_detector
from cp_env.detector.training import data
from cp_env.detector.training.data import RasterisedScene, draw
from cp_env.detector.training.train import Args, batch_loss, load, main, train
from tests.helpers.toy_scenes import ToySource

TINY = Args(frames=1, egos=1, views=2, agents=2, threads=1, checkpoint_every=2, learning_rate=2e-3)


def test_the_loss_falls(scenes: list[RasterisedScene], tmp_path: Path) -> None:
    """One view, seen again and again."""
    args = replace(TINY, out=tmp_path, steps=25, checkpoint_every=25)
    from cp_env.detector.training import train as module

    losses = []
    with pytest.MonkeyPatch.context() as patch:
        batch = draw(scenes, np.random.default_rng(0), frames=1, egos=1, views=2, agents=2)
        patch.setattr(module, "draw", lambda *_, **__: batch)
        real = module.batch_loss
        patch.setattr(module, "batch_loss", lambda *a, **k: losses.append(real(*a, **k)) or losses[-1])
        train(args, scenes)
    assert losses[-1] < 0.4 * losses[0]


def test_a_killed_run_ends_where_it_would_have(scenes: list[RasterisedScene], tmp_path: Path) -> None:
    whole = train(replace(TINY, out=tmp_path / "whole", steps=4), scenes)

    class Killed(Exception):
        pass

    from cp_env.detector.training import train as module

    def dies(*args: object, **kwargs: object) -> data.Batch:
        calls.append(1)
        if len(calls) == 4:
            raise Killed
        return draw(*args, **kwargs)  # type: ignore[arg-type]

    calls: list[int] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "draw", dies)
        with pytest.raises(Killed):
            train(replace(TINY, out=tmp_path / "killed", steps=4), scenes)
    again = train(replace(TINY, out=tmp_path / "killed", steps=4), scenes)
    assert again.digest == whole.digest


def test_kept_maps_are_the_encoders(known: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    args = replace(TINY, fusion="max", encoder=known, cache=tmp_path, stride=2)
    source = ToySource(n_frames=2)
    scenes = load(args, source)
    detector = read_detector(known).eval()
    batch = draw(scenes, np.random.default_rng(0), frames=1, egos=2, views=2, agents=4)
    assert batch.maps is not None and len(batch.maps) == len(batch.occupancy)
    with torch.no_grad():
        torch.testing.assert_close(batch.maps, detector.encode_grids(batch.occupancy), atol=2e-3, rtol=2e-3)
    monkeypatch.setattr(Detector, "encode_grids", lambda *_: pytest.fail("encoded again"))
    assert np.array_equal(load(args, source)[0].maps, scenes[0].maps)
    other = Detector()
    assert other.maps_digest != detector.maps_digest


@pytest.mark.parametrize("name", FUSIONS)
def test_heads_learn_behind_a_fixed_encoder(
    name: str, known: Path, scenes: list[RasterisedScene], tmp_path: Path
) -> None:
    before = read_detector(known)
    args = replace(TINY, fusion=name, encoder=known, out=tmp_path, steps=3)
    trained = train(args, scenes)
    assert trained.fusion == name and trained.maps_digest == before.maps_digest
    assert not torch.equal(trained.decoder.stem.conv.weight, before.decoder.stem.conv.weight)
    fresh = FUSIONS[name](trained.channels).state_dict()
    learned = trained.fuser.state_dict()
    assert learned.keys() == fresh.keys()
    assert all((value - fresh[key]).any() for key, value in learned.items())
    save_detector(trained, tmp_path / f"{name}.safetensors")
    assert read_detector(tmp_path / f"{name}.safetensors").fusion == name


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


def test_what_does_not_go_together_is_refused(known: Path, scenes: list[RasterisedScene], tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="choose one"):
        Args(encoder=known, init=known)
    with pytest.raises(ValueError, match="leave --fusion at mean, not max"):
        Args(early=True, fusion="max")
    with pytest.raises(ValueError, match="fuses by mean, not sum"):
        train(replace(TINY, init=known, fusion="sum", out=tmp_path), scenes)


@pytest.mark.parametrize("early", [False, True])
def test_half_precision_is_near_and_leaves_weights_in_single(
    early: bool, known: Path, scenes: list[RasterisedScene]
) -> None:
    """bfloat16 has eight bits: losses differ by some thousandths, gradients point the same way."""
    batch = draw(scenes, np.random.default_rng(0), frames=1, egos=2, views=3, agents=4)
    losses, gradients = [], []
    for half in (False, True):
        detector = read_detector(known).train()
        loss = batch_loss(detector, batch, early=early, half=half)
        loss.backward()
        assert loss.dtype == torch.float32
        assert all(p.dtype == torch.float32 and p.grad is not None for p in detector.parameters())
        losses.append(loss.item())
        gradients.append(torch.cat([p.grad.flatten() for p in detector.parameters() if p.grad is not None]))
    assert losses[0] != losses[1] and losses[1] == pytest.approx(losses[0], rel=0.02)
    assert torch.cosine_similarity(*gradients, dim=0) > 0.98


def test_precision_reaches_the_loss(scenes: list[RasterisedScene], tmp_path: Path) -> None:
    single, half = (
        train(replace(TINY, out=tmp_path / precision, precision=precision, steps=1), scenes)
        for precision in ("float32", "bfloat16")
    )
    assert single.digest != half.digest
