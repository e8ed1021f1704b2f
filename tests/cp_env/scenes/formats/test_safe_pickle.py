"""Pickled arrays of a data set: what is read, and what never runs."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cp_env.scenes.errors import BrokenData
from cp_env.scenes.formats.safe_pickle import load_pickled


@pytest.mark.parametrize("protocol", [3, 4, 5])
@pytest.mark.parametrize("old", [True, False])
def test_what_may_be_in_a_file(tmp_path: Path, protocol: int, old: bool) -> None:
    """Arrays of any layout, numpy scalars, plain containers; numpy 1 called its modules otherwise."""
    content = {
        "a": np.arange(6.0).reshape(2, 3),
        "b": np.asfortranarray(np.eye(3, dtype=bool)),
        "c": [np.float32(1.5), np.int64(2), (None, "text", True)],
    }
    whole = np.array(content, dtype=object)
    body = pickle.dumps(whole, protocol=protocol)
    if old and protocol == 3:  # later protocols store the length of names
        body = body.replace(b"numpy._core.", b"numpy.core.")
    with (tmp_path / "x.npy").open("wb") as file:
        np.lib.format.write_array_header_1_0(file, np.lib.format.header_data_from_array_1_0(whole))
        file.write(body)
    back = load_pickled(tmp_path / "x.npy")
    assert_allclose(back["a"], content["a"])
    assert back["b"].dtype == bool and back["c"][0] == 1.5 and back["c"][2] == (None, "text", True)
    np.save(tmp_path / "zero.npy", 0)
    assert load_pickled(tmp_path / "zero.npy") == 0


@pytest.mark.parametrize(
    "module", ["os.system", "builtins.eval", "numpy.load", "numpy.ndarray.tofile", "_codecs.encode"]
)
def test_what_may_not(tmp_path: Path, module: str) -> None:
    home, _, name = module.rpartition(".")
    with (tmp_path / "x.npy").open("wb") as file:
        header = np.lib.format.header_data_from_array_1_0(np.array(None, dtype=object))
        np.lib.format.write_array_header_1_0(file, header)
        file.write(f"c{home}\n{name}\n(S'true'\ntR.".encode())
    with pytest.raises(BrokenData, match=rf"it asks for {module}"):
        load_pickled(tmp_path / "x.npy")
