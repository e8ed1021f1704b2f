"""Detectors by name, by place and as objects."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch

import cp_env
from cp_env.detector import Detector, load_detector
from cp_env.detector.coperception import CoperceptionDetector
from cp_env.detector.model.base import BaseDetector
from cp_env.detector.registry import open_detector
from cp_env.types import Sweep
from examples.bring_your_own_detector import Toy
from tests.reference import coperception as twin


def test_a_name_is_the_shipped_detector_of_its_fusion() -> None:
    assert open_detector() is load_detector("mean")
    assert open_detector("cp_env", fusion="max") is open_detector("cp_env:fusion=max") is load_detector("max")


def test_a_class_of_yours_is_built_and_frozen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mine", SimpleNamespace(Toy=Toy, Sweep=Sweep))
    made = open_detector("mine:Toy")
    assert isinstance(made, Toy) and isinstance(made, BaseDetector)
    assert not made.training and not any(p.requires_grad for p in made.parameters())
    env = cp_env.parallel_env("none", scenes="town/test", detector="mine:Toy")
    assert isinstance(env.game.world.detector, Toy)
    with pytest.raises(ValueError, match=r"is no detector.*encode, warp, coverage.*nothing was called"):
        open_detector("mine:Sweep")


@pytest.mark.parametrize(
    ("detector", "message"),
    [
        ("os:abort", "nothing was called"),
        ("cp_nev", r"unknown detector 'cp_nev' \(did you mean 'cp_env'"),
        ("cp_env:wieghts=a", r"did you mean 'weights'"),
        ("coperception", "come together"),
    ],
)
def test_what_is_no_detector_is_told(detector: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        open_detector(detector)


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.parametrize("device", [None, 0, 1.5, b"cpu", ["cpu"]])
def test_a_device_is_a_name(device: Any) -> None:
    """Torch takes None for its default, and a number for a GPU."""
    with pytest.raises(ValueError, match="device must be a name"):
        open_detector("cp_env", device=device)


@pytest.mark.parametrize("device", ["cuda:7", "abacus", "xla"])
def test_a_device_that_is_not_there_is_told(device: str) -> None:
    if device.startswith("cuda") and torch.cuda.is_available():
        pytest.skip("there is a GPU here")
    with pytest.raises(ValueError, match=f"device '{device}' cannot be used here"):
        open_detector("cp_env", device=device)


def test_coperceptions_options_stand_in_its_name(tmp_path: Path) -> None:
    path = tmp_path / "epoch_100.pth"
    twin.save(twin.random_state("max"), path)
    plain = open_detector(f"coperception:checkpoint={path}", fusion="max")
    every = open_detector(f"coperception:checkpoint={path},all_boxes=true,resampling=rotate-translate", fusion="max")
    assert isinstance(plain, CoperceptionDetector) and isinstance(every, CoperceptionDetector)
    assert (plain.all_boxes, every.all_boxes) == (False, True)
    assert (plain.resampling, every.resampling) == ("affine", "rotate-translate")
    assert plain.digest != every.digest
    with pytest.raises(ValueError, match=r"did you mean 'all_boxes'"):
        open_detector(f"coperception:checkpoint={path},all_boxs=true", fusion="max")


def test_an_object_is_handed_back() -> None:
    detector = Detector(channels=8).freeze()
    assert open_detector(detector) is detector
