"""Safetensors files of others, within stated bounds: the header is read and held against them before the library is."""

from __future__ import annotations

from pathlib import Path

from safetensors import SafetensorError, safe_open
from torch import Tensor

from cp_env.scenes.formats.bounded import check_size, parse_json

FILE_BYTES = 1 << 30
"""A file is at most so long."""

HEADER_BYTES = 1 << 20
"""Its header, names and notes included, is at most so long."""

TENSORS = 4096
"""Tensors of a file, at most."""

_DTYPES = ("F16", "BF16", "F32", "F64", "I32", "I64")


def read_metadata(path: Path) -> dict[str, str]:
    """The notes of a file, texts by name.

    Raises:
        OSError: it cannot be read.
        ValueError: it is none, or its header exceeds a bound.
    """
    size = check_size(path, FILE_BYTES)
    with path.open("rb") as file:
        length = int.from_bytes(file.read(8), "little")
        if not 2 <= length <= min(HEADER_BYTES, size - 8):
            raise ValueError(f"it is no safetensors file with a header of at most {HEADER_BYTES} bytes")
        header = parse_json(file.read(length), depth=4)
    if not isinstance(header, dict) or len(header) > TENSORS + 1:
        raise ValueError(f"it is no safetensors file of at most {TENSORS} tensors")
    notes = header.pop("__metadata__", {})
    if not isinstance(notes, dict) or not all(isinstance(value, str) for value in notes.values()):
        raise ValueError("its notes are no texts")
    for name, said in header.items():
        if not isinstance(said, dict) or said.get("dtype") not in _DTYPES:
            raise ValueError(f"its tensor {name[:80]!r} is of none of the types {', '.join(_DTYPES)}")
    return notes


def read_tensors(path: Path) -> tuple[dict[str, str], dict[str, Tensor]]:
    """The notes of a file, and its tensors by name, on the CPU.

    Raises:
        OSError: it cannot be read.
        ValueError: it is broken, or exceeds a bound.
    """
    notes = read_metadata(path)
    try:
        with safe_open(path, framework="pt") as file:
            return notes, {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118 (not a dict)
    except SafetensorError as error:
        raise ValueError(f"it is broken: {str(error)[:500]}") from error
