"""A checkpoint whose keys do not fit says which and why; nothing in it is run."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

from cp_env.detector.coperception import load_checkpoint
from cp_env.detector.coperception.checkpoint import Weights, read
from cp_env.detector.registry import open_detector


def parts(*names: str) -> dict[str, torch.Tensor]:
    """A state that has one tensor of each part."""
    return {f"module.{name}.weight": torch.zeros(1) for name in names}


MEAN = ("u_encoder", "decoder", "classification", "regression")


def written(path: Path, content: object) -> Path:
    torch.save(content, path)
    return path


@pytest.mark.parametrize(
    ("names", "fusion", "message"),
    [
        ((*MEAN, "convgru"), "mean", r'does not fit fusion="mean": it holds convgru.*; use fusion="v2vnet"'),
        ((*MEAN, "pixel_weighted_fusion"), "max", r'it holds pixel_weighted_fusion.*use fusion="disconet"'),
        (MEAN, "v2vnet", r'does not fit fusion="v2vnet": it holds no convgru.*use fusion="mean", "max" or "sum"'),
        (MEAN, "disconet", r"it holds no pixel_weighted_fusion"),
        ((*MEAN, "query_key_net", "attention_net"), "sum", r"it holds attention_net, query_key_net, which no model of"),
        (MEAN[1:], "mean", r"it needs u_encoder.* and decoder.* \(or stpn.*\), and holds classification, decoder"),
        (MEAN, "mean", r"it holds no 'u_encoder.conv_pre_1.weight'; its parts are classification, decoder, regression"),
        (("stpn", *MEAN[2:]), "mean", r"it holds no 'stpn.conv_pre_1.weight'"),
    ],
)
def test_parts_that_do_not_fit(tmp_path: Path, names: tuple[str, ...], fusion: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        load_checkpoint(written(tmp_path / "a.pth", {"model_state_dict": parts(*names)}), fusion=fusion)


def test_shapes_that_do_not_fit() -> None:
    weights = Weights({"module.u_encoder.conv_pre_1.weight": torch.zeros(32, 12, 3, 3)}, "a.pth")
    with pytest.raises(
        ValueError, match=r"a.pth does not fit: 'u_encoder.conv_pre_1.weight' has shape \(32, 12, 3, 3\)"
    ):
        weights.take("u_encoder.conv_pre_1.weight", 32, 13, 3, 3)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"state_dict": {}}, r"has no 'model_state_dict' of tensors; it holds state_dict"),
        ({"model_state_dict": {"a": 1}}, r"has no 'model_state_dict' of tensors"),
        ([1, 2], r"it holds list"),
    ],
)
def test_other_files(tmp_path: Path, content: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        read(written(tmp_path / "a.pth", content))


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"no checkpoint at .*nowhere.pth: the file is missing"):
        load_checkpoint(tmp_path / "nowhere.pth")
    torn = written(tmp_path / "torn.pth", {"model_state_dict": {"a": torch.zeros(1000)}})
    torn.write_bytes(torn.read_bytes()[:-700])
    with pytest.raises(ValueError, match=r"cannot read the checkpoint .*torn.pth"):
        read(torn)
    (tmp_path / "text.pth").write_text("no checkpoint")
    with pytest.raises(ValueError, match="cannot read the checkpoint"):
        read(tmp_path / "text.pth")


class Bomb:
    """Unpickled, it would make a directory."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[str]]:
        return os.mkdir, (str(self.path),)


def test_a_checkpoint_is_never_run(tmp_path: Path) -> None:
    content = {"model_state_dict": parts(*MEAN), "loss": Bomb(tmp_path / "ran")}
    with pytest.raises(ValueError, match=r"holds objects that are not run here.*keep the weights alone: torch.save"):
        read(written(tmp_path / "a.pth", content))
    assert not (tmp_path / "ran").exists()


def test_names_and_numbers(tmp_path: Path) -> None:
    for options, message in (
        ({"fusion": "cat"}, r"unknown fusion 'cat': choose one of mean, max, sum, v2vnet, disconet"),
        ({"resampling": "twice"}, r"unknown resampling 'twice': choose one of affine, rotate-translate"),
        ({"rounds": 0}, "rounds must be at least 1, not 0"),
    ):
        with pytest.raises(ValueError, match=message):
            load_checkpoint(tmp_path / "a.pth", **options)  # type: ignore[arg-type]


def test_a_detector_by_its_name() -> None:
    with pytest.raises(ValueError, match=r"unknown detector 'yolo'; known: cp_env, coperception; or module:Class"):
        open_detector("yolo")
    for options in ({"detector": "coperception"}, {"detector": "cp_env", "checkpoint": "a.pth"}):
        with pytest.raises(ValueError, match=r'detector="coperception" and its checkpoint="file" come together'):
            open_detector(**options)
