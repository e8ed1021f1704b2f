"""Torch's files read without torch's unpickler: equal to what torch reads, and held to the numbers that are there."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import nn

from cp_env.detector.coperception import torch_file
from cp_env.detector.coperception.checkpoint import read
from cp_env.detector.coperception.torch_file import StoredTensor, TorchFile


def trained() -> dict[str, Any]:
    """What coperception saves: a model, its optimiser with moments, a scheduler, numbers."""
    torch.manual_seed(0)
    model = nn.Sequential(nn.Conv2d(2, 3, 3), nn.BatchNorm2d(3))
    optimizer = torch.optim.Adam(model.parameters())
    model(torch.rand(2, 2, 5, 5)).square().sum().backward()
    optimizer.step()
    scheduler = torch.optim.lr_scheduler.MultiStepLR(optimizer, [5, 10])
    return {
        "epoch": 3,
        "model_state_dict": model.state_dict(),
        "optimizer_state_dict": optimizer.state_dict(),
        "scheduler_state_dict": scheduler.state_dict(),
        "loss": torch.tensor(1.5),
    }


def saved(content: object) -> bytes:
    file = io.BytesIO()
    torch.save(content, file)
    return file.getvalue()


def test_a_checkpoint_is_read_as_torch_reads_it(tmp_path: Path) -> None:
    content = trained()
    (tmp_path / "a.pth").write_bytes(saved(content))
    weights = read(tmp_path / "a.pth")
    for key, tensor in content["model_state_dict"].items():
        assert torch.equal(weights.take(key, *tensor.shape), tensor.float())
    with TorchFile(tmp_path / "a.pth") as file:
        assert file.content["epoch"] == 3 and isinstance(file.content["loss"], StoredTensor)
        assert file.tensor(file.content["loss"]).item() == 1.5
        assert dict(file.content["scheduler_state_dict"]["milestones"]) == {5: 1, 10: 1}


@pytest.mark.parametrize(
    "dtype", [torch.float64, torch.float32, torch.float16, torch.bfloat16, torch.int64, torch.uint8]
)
def test_views_of_one_storage(tmp_path: Path, dtype: torch.dtype) -> None:
    whole = torch.arange(24).reshape(4, 6).to(dtype)
    views = {"a": whole, "b": whole.t(), "c": whole[1:3, 2:5], "d": whole[:0], "e": nn.Parameter(whole.double()).data}
    (tmp_path / "a.pth").write_bytes(saved({"model_state_dict": views}))
    weights = read(tmp_path / "a.pth")
    assert all(torch.equal(weights.take(key, *view.shape), view.float()) for key, view in views.items())


def rewritten(content: object, change: Callable[[str, bytes], bytes | None]) -> bytes:
    """The archive with its members changed, or left out where None is given."""
    file = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(saved(content))) as old, zipfile.ZipFile(file, "w") as new:
        for member in old.infolist():
            data = change(member.filename.partition("/")[2], old.read(member))
            if data is not None:
                new.writestr(member.filename, data)
    return file.getvalue()


def only(name: str, change: Callable[[bytes], bytes | None]) -> Callable[[str, bytes], bytes | None]:
    return lambda member, data: change(data) if member == name else data


ONE = {"model_state_dict": {"a": torch.arange(100.0)}}


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (lambda: rewritten(ONE, only("data/0", lambda data: data[:40])), "its numbers end too soon"),
        (lambda: rewritten(ONE, only("data/0", lambda data: data * 2)), "holds 800 bytes, where 400 are expected"),
        (lambda: rewritten(ONE, only("data/0", lambda data: None)), "it lacks data/0"),
        (lambda: rewritten(ONE, only("data.pkl", lambda data: None)), "it lacks data.pkl"),
        (lambda: rewritten(ONE, only("byteorder", lambda data: b"big")), "highest byte"),
        (lambda: rewritten(ONE, only("data.pkl", lambda d: d.replace(b"Kd\x85", b"K\xff\x85"))), "end too soon"),
        (lambda: rewritten(ONE, only("data.pkl", lambda d: d.replace(b"QK\x00", b"QK\x01"))), "end too soon"),
        (lambda: rewritten(ONE, only("data.pkl", lambda d: d.replace(b"K\x01\x85", b"K\xff\x85"))), "end too soon"),
        (lambda: saved({"model_state_dict": {"a": torch.tensor([1.0, float("nan")])}}), "no finite number"),
        (lambda: b"\x80\x02\x8a\nl\xfc\x9cF\xf9 j\xa8P\x19." * 50, "since its version 1.6|its end is missing"),
    ],
)
def test_numbers_that_are_not_there_are_not_read(tmp_path: Path, data: Any, message: str) -> None:
    (tmp_path / "a.pth").write_bytes(data())
    with pytest.raises(ValueError, match=f"a.pth: .*({message})"):
        read(tmp_path / "a.pth")


def test_a_file_is_held_to_its_bounds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.pth").write_bytes(saved({"model_state_dict": {f"{i}": torch.zeros(100) for i in range(9)}}))
    for name, value, message in (
        ("FILE_BYTES", 1000, "at most 1000 are read"),
        ("PICKLE_BYTES", 20, "where 20 are expected"),
        ("RECORDS", 3, "at most 3 are read"),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(torch_file, name, value)
            with pytest.raises(ValueError, match=message):
                read(tmp_path / "a.pth")
