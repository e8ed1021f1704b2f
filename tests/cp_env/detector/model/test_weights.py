"""Weights files: what is written is read, what is broken is named."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file

from cp_env.detector import Detector, load_detector
from cp_env.detector.model.bev import BEV
from cp_env.detector.model.weights import FORMAT, about, read_detector, save_detector


@pytest.fixture
def trained() -> Detector:
    """Random weights, with normalisation that has seen data."""
    torch.manual_seed(1)
    detector = Detector(threshold=0.4)
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for _ in range(2):
            detector.decode(detector.encode_grids(torch.rand(2, BEV.slices, 256, 256, generator=generator) < 0.05))
    return detector.eval()


def grids(seed: int) -> torch.Tensor:
    return torch.rand(1, BEV.slices, 256, 256, generator=torch.Generator().manual_seed(seed)) < 0.05


def test_round_trip(trained: Detector, tmp_path: Path) -> None:
    path = tmp_path / "mean.safetensors"
    save_detector(trained, path, steps=7)
    again = read_detector(path).eval()
    assert (again.threshold, again.channels, again.fusion) == (0.4, 128, "mean")
    assert about(path) == {"steps": 7}
    save_detector(again, tmp_path / "again.safetensors")
    assert read_detector(tmp_path / "again.safetensors").digest == again.digest  # rounded once, for good
    assert path.stat().st_size < 5e6
    close = torch.allclose(again.encode_grids(grids(0)), trained.encode_grids(grids(0)), atol=0.02)
    assert close


def test_frozen_is_the_same_function(trained: Detector) -> None:
    with torch.no_grad():
        maps = trained.encode_grids(grids(0))
        dense = trained.decode(maps)
        trained.freeze()
        assert torch.allclose(trained.encode_grids(grids(0)), maps, atol=1e-3)
        after = trained.decode(maps)
    assert torch.allclose(after.logits, dense.logits, atol=1e-3) and torch.allclose(after.boxes, dense.boxes, atol=1e-3)


def test_the_shipped_detector_is_frozen_and_shared() -> None:
    detector = load_detector()
    assert load_detector() is detector and load_detector("mean", "cpu").digest == detector.digest
    assert not detector.training and not any(p.requires_grad for p in detector.parameters())
    before = detector.digest
    maps = torch.rand(1, 128, 32, 32, requires_grad=True, generator=torch.Generator().manual_seed(0))
    detector.decode(maps).logits.sum().backward()
    assert maps.grad is not None and maps.grad.any()
    assert detector.digest == before
    assert detector.floor < detector.threshold < 1


def test_the_digest_sees_every_weight(trained: Detector) -> None:
    before = trained.digest
    with torch.no_grad():
        trained.decoder.head.bias[3] += 1e-3
    assert trained.digest != before


def test_an_unknown_name_lists_the_known() -> None:
    with pytest.raises(ValueError, match="unknown detector 'median'; known: mean"):
        load_detector("median")


def test_broken_files_are_named(trained: Detector, tmp_path: Path) -> None:
    path = tmp_path / "mean.safetensors"
    with pytest.raises(ValueError, match=r"no weights at .*mean\.safetensors"):
        read_detector(path)
    path.write_bytes(b"not a tensor in sight")
    with pytest.raises(ValueError, match=r"cannot read the weights in .*mean\.safetensors"):
        read_detector(path)
    save_detector(trained, path)
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(ValueError, match=r"cannot read the weights in .*mean\.safetensors"):
        read_detector(path)
    save_file({"w": torch.zeros(1)}, path)
    with pytest.raises(ValueError, match=r"mean\.safetensors are of format None"):
        read_detector(path)
    about = {"format": "cp_env detector 1", "grid": str(BEV), "fusion": "mean", "channels": 128, "threshold": 0.3}
    save_file({"w": torch.zeros(1)}, path, metadata={key: json.dumps(value) for key, value in about.items()})
    with pytest.raises(ValueError, match=r"mean\.safetensors do not fit"):
        read_detector(path)


GOOD = {"format": FORMAT, "grid": str(BEV), "fusion": "mean", "channels": 8, "threshold": 0.3}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"channels": 10**9}, "with 1 to 1024 channels"),
        ({"channels": 0}, "with 1 to 1024 channels"),
        ({"channels": "8"}, "with 1 to 1024 channels"),
        ({"channels": None}, "with 1 to 1024 channels"),
        ({"fusion": "median"}, "fusion is one of"),
        ({"fusion": ["mean"]}, "fusion is one of"),
        ({"threshold": float("nan")}, "of no detector"),
        ({"threshold": 2}, "of no detector"),
        ({"note": json.loads("[" * 50 + "]" * 50)}, "nested deeper"),
    ],
)
def test_what_weights_must_say_of_themselves(tmp_path: Path, change: dict[str, object], message: str) -> None:
    path = tmp_path / "a.safetensors"
    about = {key: json.dumps(value) for key, value in (GOOD | change).items()}
    save_file({"w": torch.zeros(1)}, path, metadata=about)
    with pytest.raises(ValueError, match=rf"a\.safetensors.*{message}"):
        read_detector(path)


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_weights_that_are_not_finite_are_refused(tmp_path: Path, bad: float) -> None:
    detector = Detector(channels=8)
    with torch.no_grad():
        detector.decoder.head.bias[1] = bad
    save_detector(detector, tmp_path / "a.safetensors")
    with pytest.raises(ValueError, match=r"a\.safetensors hold numbers that are not finite, in decoder\.head\.bias"):
        read_detector(tmp_path / "a.safetensors")
