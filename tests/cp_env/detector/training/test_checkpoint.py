"""Checkpoints: what is written comes back to the bit, and what is broken or of others is refused by name."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import nn

from cp_env.detector.training.checkpoint import resume, write_checkpoint


def stepped(seed: int, steps: int = 2) -> tuple[nn.Module, torch.optim.Optimizer]:
    """A small network with a buffer, after some steps."""
    generator = torch.Generator().manual_seed(seed)
    model = nn.Sequential(nn.Linear(3, 4), nn.BatchNorm1d(4))
    for parameter in model.parameters():
        nn.init.normal_(parameter, generator=generator)
    optimizer = torch.optim.AdamW(model.parameters(), weight_decay=0.1)
    for _ in range(steps):
        optimizer.zero_grad()
        (model(torch.rand(5, 3, generator=generator)) ** 2).sum().backward()
        optimizer.step()
    return model, optimizer


def test_what_is_written_comes_back(tmp_path: Path) -> None:
    path = tmp_path / "checkpoint.safetensors"
    model, optimizer = stepped(0)
    write_checkpoint(path, model, optimizer, 7)
    other, moments = stepped(1)
    assert resume(path, other, moments) == 7
    for key, tensor in model.state_dict().items():
        assert torch.equal(other.state_dict()[key], tensor), key
    known, found = optimizer.state_dict()["state"], moments.state_dict()["state"]
    assert known.keys() == found.keys() and known
    for number in known:
        assert known[number].keys() == found[number].keys()
        assert all(torch.equal(known[number][name], found[number][name]) for name in known[number])


def test_without_a_file_one_begins_at_the_first_step(tmp_path: Path) -> None:
    assert resume(tmp_path / "checkpoint.safetensors", *stepped(0)) == 0


def test_a_broken_file_and_one_of_another_network_are_named(tmp_path: Path) -> None:
    path = tmp_path / "checkpoint.safetensors"
    write_checkpoint(path, *stepped(0), 1)
    narrow = nn.Linear(2, 2)
    with pytest.raises(ValueError, match=r"(?s)checkpoint\.safetensors.*delete it"):
        resume(path, narrow, torch.optim.AdamW(narrow.parameters()))
    whole = path.read_bytes()
    for broken in (b"", whole[:40], whole[:-8], b"\x80\x02." + whole):
        path.write_bytes(broken)
        with pytest.raises(ValueError, match=r"(?s)checkpoint\.safetensors.*delete it"):
            resume(path, *stepped(0))
