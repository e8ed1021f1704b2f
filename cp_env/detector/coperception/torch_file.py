"""Files of `torch.save`, read by a pickle machine of our own: tensors and plain values, within stated bounds.

Since torch 1.6 such a file is a zip archive: `data.pkl` describes the tensors, `data/<key>` holds their numbers. Sizes,
strides and offsets are held against those numbers, which `torch.load` does not do. Older files are refused.
"""

from __future__ import annotations

import math
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from cp_env.scenes.formats import pickle_program
from cp_env.scenes.formats.bounded import check_size
from cp_env.scenes.formats.plain_numpy import check_archive, check_directory
from cp_env.scenes.formats.safe_pickle import MAKERS

FILE_BYTES = 1 << 30
"""A file is at most so long, and so are its tensors."""

PICKLE_BYTES = 8 << 20
"""The description of the tensors is at most so long."""

RECORDS = 20_000
"""Storages of a file, at most."""

_DTYPES = {
    "DoubleStorage": torch.float64,
    "FloatStorage": torch.float32,
    "HalfStorage": torch.float16,
    "BFloat16Storage": torch.bfloat16,
    "LongStorage": torch.int64,
    "IntStorage": torch.int32,
    "ShortStorage": torch.int16,
    "CharStorage": torch.int8,
    "ByteStorage": torch.uint8,
}


@dataclass(frozen=True)
class StoredTensor:
    """A tensor of the file, its numbers not read yet."""

    key: str
    dtype: torch.dtype
    storage: int  # numbers that its storage holds
    offset: int
    shape: tuple[int, ...]
    strides: tuple[int, ...]


class TorchFile:
    """An open file; `content` is what was saved, with a `StoredTensor` for each tensor.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is none of torch's, exceeds a bound, or asks for anything but tensors and plain values.
    """

    def __init__(self, path: Path) -> None:
        self._storages: dict[str, bytearray] = {}
        self._taken = 0  # bytes of the tensors handed out
        size = check_size(path, FILE_BYTES)
        with path.open("rb") as file:
            file.seek(max(size - (1 << 17), 0))
            check_directory(file.read(1 << 17), limit=4 << 20)
        try:
            self._zip = zipfile.ZipFile(path)
        except (zipfile.BadZipFile, NotImplementedError) as error:
            raise ValueError(
                f"it is no archive as torch writes them since its version 1.6 ({str(error)[:200]})"
            ) from error
        try:
            self._members = {member.filename: member for member in check_archive(self._zip, FILE_BYTES, RECORDS)}
            found = [name for name in self._members if name.count("/") == 1 and name.endswith("/data.pkl")]
            if len(found) != 1:
                raise ValueError("it is no archive of torch's: it lacks data.pkl")
            self._root = found[0].removesuffix("data.pkl")
            if self._read("byteorder", 16, missing=b"little") != b"little":
                raise ValueError("its numbers begin with the highest byte; save it again on another machine")
            program = self._read("data.pkl", PICKLE_BYTES)
            self.content: Any = pickle_program.run(program, _MAKERS, (StoredTensor,), _storage)
        except BaseException:
            self._zip.close()
            raise

    def __enter__(self) -> TorchFile:
        return self

    def __exit__(self, *_: object) -> None:
        self._zip.close()

    def tensor(self, stored: StoredTensor) -> Tensor:
        """The tensor itself.

        Raises:
            ValueError: its numbers are missing, fewer or more than was said, do not reach as far as its shape, are not
                finite, or make more than `FILE_BYTES` together with those asked for before.
        """
        length = stored.storage * stored.dtype.itemsize
        if stored.key not in self._storages:
            self._storages[stored.key] = bytearray(self._read(f"data/{stored.key}", length))
        data = self._storages[stored.key]
        last = stored.offset + sum((n - 1) * s for n, s in zip(stored.shape, stored.strides, strict=True))
        count = math.prod(stored.shape)
        if len(data) != length or (count and last >= stored.storage) or count > stored.storage:
            raise ValueError(f"a tensor of shape {stored.shape} over {len(data)} bytes: its numbers end too soon")
        self._taken += count * stored.dtype.itemsize
        if self._taken > FILE_BYTES:
            raise ValueError(f"its tensors hold more than {FILE_BYTES} bytes")
        if not count:
            return torch.zeros(stored.shape, dtype=stored.dtype)
        flat = torch.frombuffer(data, dtype=stored.dtype)
        tensor = flat.as_strided(stored.shape, stored.strides, stored.offset).contiguous()
        if not bool(torch.isfinite(tensor).all()):
            raise ValueError(f"a tensor of shape {stored.shape} holds what is no finite number")
        return tensor

    def _read(self, name: str, limit: int, missing: bytes | None = None) -> bytes:
        member = self._members.get(self._root + name)
        if member is None:
            if missing is None:
                raise ValueError(f"it lacks {name[:80]}")
            return missing
        if member.file_size > limit:
            raise ValueError(f"{name[:80]} holds {member.file_size} bytes, where {limit} are expected")
        try:
            return self._zip.read(member)
        except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError) as error:
            raise ValueError(f"{name[:80]} is broken: {str(error)[:200]}") from error


@dataclass(frozen=True)
class _Kind:
    """A class of storages: named, never called."""

    dtype: torch.dtype


@dataclass(frozen=True)
class _Storage:
    key: str
    dtype: torch.dtype
    count: int


def _storage(said: Any) -> _Storage:
    what, kind, key, _, count = said
    if what != "storage" or not isinstance(kind, _Kind) or type(key) is not str or not _is_count(count):
        raise ValueError("a storage that is none of torch's")
    return _Storage(key, kind.dtype, count)


def _tensor(storage: Any, offset: Any, shape: Any, strides: Any, *_: Any) -> StoredTensor:
    if not isinstance(storage, _Storage) or not _is_count(offset) or len(shape) != len(strides) or len(shape) > 8:
        raise ValueError("a tensor without a storage or a shape")
    if type(shape) is not tuple or type(strides) is not tuple or not all(map(_is_count, (*shape, *strides))):
        raise ValueError("a tensor whose shape is none")
    return StoredTensor(storage.key, storage.dtype, storage.count, offset, shape, strides)


def _parameter(tensor: Any, *_: Any) -> StoredTensor:
    if not isinstance(tensor, StoredTensor):
        raise ValueError("a parameter without a tensor")
    return tensor


def _dictionary(*pairs: Any) -> dict[Any, Any]:
    """An ordered dictionary, which is filled later; or a counter, filled at once."""
    if not pairs:
        return {}
    if len(pairs) != 1 or type(pairs[0]) is not dict:
        raise ValueError("a dictionary that is made of something else")
    return dict(pairs[0])


def _is_count(number: Any) -> bool:
    return type(number) is int and 0 <= number <= FILE_BYTES


_MAKERS: dict[str, Any] = {
    **MAKERS,
    **{f"torch.{name}": _Kind(dtype) for name, dtype in _DTYPES.items()},
    "torch._utils._rebuild_tensor_v2": _tensor,
    "torch._utils._rebuild_parameter": _parameter,
    "collections.OrderedDict": _dictionary,
    "collections.Counter": _dictionary,
}
"""All that may be named: numpy's numbers, torch's tensors, and two kinds of dictionaries."""
