"""Pickled numpy files of others, without running their code: only arrays, scalars and plain containers are made."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import IO, Any

import numpy as np

from cp_env.scenes.errors import BrokenData

_MAKERS = {
    "ndarray": np.ndarray,
    "dtype": np.dtype,
    "_reconstruct": np.zeros(0).__reduce__()[0],
    "scalar": np.float64(0).__reduce__()[0],
    "_frombuffer": np.zeros(0).__reduce_ex__(5)[0],
}
"""All that numpy's own pickles call, by name; the module it lived in differs between versions of numpy."""
_MODULES = ("numpy", *(f"numpy.{core}.{part}" for core in ("core", "_core") for part in ("multiarray", "numeric")))


def load_pickled(path: Path) -> Any:
    """What a `.npy` file holds that was saved with pickling: an array, or the object in an array of one object.

    Raises:
        BrokenData: the file cannot be read, is no such file, or asks for anything but arrays and plain containers.
    """
    try:
        with path.open("rb") as file:
            return _read(file)
    except FileNotFoundError as error:
        raise BrokenData(path, "missing file") from error
    except Exception as error:  # a broken pickle can raise anything
        raise BrokenData(path, f"it cannot be read: {error}") from error


def _read(file: IO[bytes]) -> Any:
    version = np.lib.format.read_magic(file)
    header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    _, _, dtype = header(file)
    if not dtype.hasobject:
        file.seek(0)
        return np.lib.format.read_array(file, allow_pickle=False)[()]
    array = _Restricted(file, encoding="latin1").load()
    if not isinstance(array, np.ndarray):
        raise pickle.UnpicklingError(f"it holds a {type(array).__name__} where an array should be")
    return array[()]


class _Restricted(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        if module not in _MODULES or name not in _MAKERS:
            raise pickle.UnpicklingError(f"it asks for {module}.{name}; only arrays and plain containers are read")
        return _MAKERS[name]
