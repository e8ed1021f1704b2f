"""Pickled numpy files of others, without running their code: only arrays, scalars and plain containers are made."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from cp_env.scenes.errors import BrokenData
from cp_env.scenes.formats import pickle_program
from cp_env.scenes.formats.bounded import read_bytes
from cp_env.scenes.formats.plain_numpy import OBJECTS, parse_npy, plain_array, plain_dtype, read_header

PICKLE_BYTES = 64 << 20
"""A file is at most so long."""


def load_pickled(path: Path) -> Any:
    """What a `.npy` file holds that was saved with pickling: an array, or the object in an array of one object.

    Raises:
        BrokenData: the file cannot be read, is no such file, exceeds a bound, or asks for anything but arrays of plain
            numbers and plain containers.
    """
    try:
        data = read_bytes(path, PICKLE_BYTES)
        header = read_header(data)
        if header.descr != OBJECTS:
            return parse_npy(data)[()]
        array = pickle_program.run(data[header.start :], MAKERS)
    except FileNotFoundError as error:
        raise BrokenData(path, "missing file") from error
    except (OSError, ValueError) as error:
        raise BrokenData(path, f"it cannot be read: {error}") from error
    if not isinstance(array, np.ndarray):
        raise BrokenData(path, f"it cannot be read: it holds a {type(array).__name__} where an array should be")
    return array[()]


class _Type(pickle_program.Draft):
    """A type whose byte order is still to be read: state (3, "<", None, None, None, -1, -1, 0)."""

    def __init__(self, name: Any, align: Any = False, copy: Any = True) -> None:
        self.name = _text(name)
        if align not in (False, 0) or copy not in (False, True):
            raise ValueError("a type that is aligned")
        if self.name != "O8":
            plain_dtype(self.name)

    def build(self, state: Any) -> np.dtype:
        version, order, *rest = state
        if version not in (3, 4) or rest[:3] != [None, None, None] or order not in ("<", ">", "|", "="):
            raise ValueError("a type of many fields")
        return np.dtype(object) if self.name == "O8" else plain_dtype(order + self.name)


class _Array(pickle_program.Draft):
    """An array whose content is still to be read: state (1, shape, type, Fortran order, content)."""

    def __init__(self, kind: Any, shape: Any, code: Any) -> None:
        if kind is not _ndarray or shape != (0,) or code not in (b"b", "b"):
            raise ValueError("an array that does not begin empty")

    def build(self, state: Any) -> np.ndarray:
        version, shape, dtype, fortran, content = state
        if version != 1:
            raise ValueError("an array of another version")
        return _array(content, dtype, shape, fortran=bool(fortran))


def _array(content: Any, dtype: Any, shape: Any, *, fortran: bool) -> np.ndarray:
    if not isinstance(dtype, np.dtype) or type(shape) is not tuple or any(type(n) is not int for n in shape):
        raise ValueError("an array without a type and a shape")
    if dtype.kind != "O":
        return plain_array(_bytes(content), dtype, shape, fortran=fortran)
    if type(content) is not list or len(shape) > 4 or math.prod(shape) != len(content) or min(shape, default=0) < 0:
        raise ValueError("an array of objects that are not listed")
    array = np.empty(len(content), dtype=object)
    for number, value in enumerate(content):
        array[number] = value
    return array.reshape(shape, order="F" if fortran else "C")


def _from_buffer(content: Any, dtype: Any, shape: Any, order: Any) -> np.ndarray:
    return _array(_bytes(content), dtype, shape, fortran=order == "F")


def _scalar(dtype: Any, content: Any) -> Any:
    if not isinstance(dtype, np.dtype) or dtype.kind == "O":
        raise ValueError("a number without a type")
    made: Any = plain_array(_bytes(content), dtype, ())[()]
    return made


def _ndarray(*arguments: Any) -> None:
    """The class of arrays: named, never called."""
    raise ValueError("an array that is made without its content")


def _bytes(content: Any) -> bytes:
    """Bytes; a text is what Python 2 wrote."""
    if isinstance(content, str):
        return content.encode("latin-1")
    if not isinstance(content, bytes):
        raise ValueError(f"numbers that lie in a {type(content).__name__}")
    return content


def _text(name: Any) -> str:
    if not isinstance(name, str | bytes):
        raise ValueError(f"a type whose name is a {type(name).__name__}")
    return name.decode("ascii") if isinstance(name, bytes) else name


_PARTS = {
    "ndarray": _ndarray,
    "dtype": _Type,
    "_reconstruct": _Array,
    "scalar": _scalar,
    "_frombuffer": _from_buffer,
}
_MODULES = ("numpy", *(f"numpy.{core}.{part}" for core in ("core", "_core") for part in ("multiarray", "numeric")))
MAKERS = {f"{module}.{name}": maker for module in _MODULES for name, maker in _PARTS.items()}
"""All that numpy's own pickles call; the module it lives in differs between versions of numpy."""
