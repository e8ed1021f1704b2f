"""Safetensors files: read as the library reads them, their headers held against bounds before."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import save_file

from cp_env.detector.model import tensors
from cp_env.detector.model.tensors import read_metadata, read_tensors

TENSORS = {"a": torch.arange(6.0).reshape(2, 3), "b": torch.zeros(2, dtype=torch.float16)}


def with_header(path: Path, header: Any, body: bytes = bytes(28)) -> Path:
    text = (header if isinstance(header, str) else json.dumps(header)).encode()
    path.write_bytes(len(text).to_bytes(8, "little") + text + body)
    return path


def test_what_was_written_is_read(tmp_path: Path) -> None:
    save_file(TENSORS, tmp_path / "a.safetensors", metadata={"note": "x"})
    notes, found = read_tensors(tmp_path / "a.safetensors")
    assert notes == read_metadata(tmp_path / "a.safetensors") == {"note": "x"} and found.keys() == TENSORS.keys()
    assert all(torch.equal(found[key], tensor) for key, tensor in TENSORS.items())
    save_file(TENSORS, tmp_path / "b.safetensors")
    assert read_metadata(tmp_path / "b.safetensors") == {}


ENTRY = {"dtype": "F32", "shape": [7], "data_offsets": [0, 28]}


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ("[" * 1000, "nested deeper"),
        ("{" + '"a":{' * 1000, "nested deeper"),
        ([], "no safetensors file of"),
        (f'{{"a": {json.dumps(ENTRY)}, "a": {json.dumps(ENTRY)}}}', "named twice"),
        ({"__metadata__": {"a": 1}, "a": ENTRY}, "no texts"),
        ({"__metadata__": [], "a": ENTRY}, "no texts"),
        ({"a": {**ENTRY, "dtype": "C64"}}, "'a' is of none of the types"),
        ({"a": 1}, "'a' is of none of the types"),
        ({"a": {**ENTRY, "data_offsets": [0, 1 << 60]}}, "broken"),
        ({"a": {**ENTRY, "shape": [1 << 60]}}, "broken"),
        ({"a": {**ENTRY, "shape": [-7]}}, "broken"),
        ({f"{i}": ENTRY for i in range(tensors.TENSORS + 2)}, f"at most {tensors.TENSORS} tensors"),
        ("x" * (tensors.HEADER_BYTES + 1), "header of at most"),
        ("not JSON", "Expecting value"),
    ],
)
def test_headers_that_are_refused(tmp_path: Path, header: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        read_tensors(with_header(tmp_path / "a.safetensors", header))


def test_lengths_that_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.safetensors"
    for data in (b"", b"1234567", (1 << 62).to_bytes(8, "little") + b"{}", (3).to_bytes(8, "little") + b"{}"):
        path.write_bytes(data)
        with pytest.raises(ValueError, match="no safetensors file"):
            read_tensors(path)
    monkeypatch.setattr(tensors, "FILE_BYTES", 5)
    with pytest.raises(ValueError, match="at most 5 are read"):
        read_tensors(path)
