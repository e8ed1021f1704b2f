"""Every reader of files: a valid file with small damage is read, or refused with a ValueError that names the file.

A crash of the interpreter, another exception, a warning, or memory beyond the bound fails the test. New readers enter
`READERS`.
"""

from __future__ import annotations

import os
import random
import shutil
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.learning.policy import FOLDER, load_policy
from cp_env.detector import Detector
from cp_env.detector.coperception import checkpoint
from cp_env.detector.model.weights import about, read_detector, save_detector
from cp_env.evaluation import Store
from cp_env.scenes.formats import pcd, recording
from cp_env.scenes.formats.bounded import parse_json, read_bytes
from cp_env.scenes.formats.plain_numpy import load_npy, load_npz
from cp_env.scenes.formats.safe_pickle import load_pickled
from cp_env.scenes.v2xsim import tables
from tests.helpers.damage import DAMAGE, damaged
from tests.helpers.toy_evaluation import CONDITIONS, RUNS, record

MEMORY = 64 << 20
"""What reading a small damaged file may take; the intact ones take a few megabytes."""


@dataclass(frozen=True)
class Reader:
    """A reader, a valid file for it, and whether its errors name the file."""

    write: Callable[[Path], Any]
    read: Callable[[Path], Any]
    names_file: bool = True


def _pcd(data: str) -> Callable[[Path], None]:
    return lambda path: pcd.write(path, np.random.default_rng(0).uniform(-50, 50, (60, 3)), data=data)


def _pickled(path: Path) -> None:
    content = {"a": np.arange(12.0).reshape(3, 4), "b": [np.ones(3, bool), np.int64(4)], "c": ("x", 1.5, None)}
    np.save(path.with_suffix(".npy"), content)  # type: ignore[arg-type]
    path.with_suffix(".npy").rename(path)


def _npy(path: Path) -> None:
    with path.open("wb") as file:
        np.save(file, np.arange(60, dtype="<f4").reshape(3, 20))


def _npz(path: Path) -> None:
    with path.open("wb") as file:
        np.savez_compressed(file, a=np.arange(50), b=np.array("text"), c=np.eye(3, dtype=bool))


def _recording(path: Path) -> None:
    shutil.copy(sorted(Path(recording.__file__).parents[1].joinpath("data").glob("*.npz"))[0], path)


def _table(path: Path) -> None:
    path.write_text('[{"token": "a", "place": [1.5, 2]}, {"token": "b\\u00e4", "place": [0, -1e3]}]')


def _read_table(path: Path) -> None:
    folder = path.parent / "tables"
    folder.mkdir(exist_ok=True)
    for name in tables.TABLES:
        (folder / f"{name}.json").write_text("[]")
    shutil.copy(path, folder / "scene.json")
    list(tables.Tables(folder, progress=False).read("scene", "token", "place"))


def _weights(path: Path) -> None:
    torch.manual_seed(0)
    save_detector(Detector(channels=8), path, note=[1, {"a": 2}])


def _checkpoint(path: Path) -> None:
    state = {"module.a.weight": torch.arange(24.0).reshape(2, 3, 4), "module.a.bias": torch.zeros(2).half()}
    torch.save({"model_state_dict": state, "epoch": 3, "loss": torch.tensor(1.0)}, path)


def _store(path: Path) -> None:
    store = Store(path.parent / "out")
    store.write(RUNS[0], CONDITIONS, RECORDS)
    shutil.copy(store.path(RUNS[0], CONDITIONS), path)


def _read_store(path: Path) -> Any:
    """A store never raises: what it cannot use is a fault."""
    store = Store(path.parent / "out")
    shutil.copy(path, store.path(RUNS[0], CONDITIONS))
    return store.examine(RUNS[0], CONDITIONS)


RECORDS = [record(name, "1101", 4, attackers=tuple(range(RUNS[0].k))) for name in RUNS[0].names]
READERS = {
    "pcd text": Reader(_pcd("ascii"), pcd.read),
    "pcd": Reader(_pcd("binary"), pcd.read),
    "recording": Reader(_recording, lambda path: recording.read(path, "x")),
    "pickled": Reader(_pickled, load_pickled),
    "npy": Reader(_npy, load_npy, names_file=False),
    "npz": Reader(_npz, load_npz, names_file=False),
    "json": Reader(_table, lambda path: parse_json(read_bytes(path, 1000)), names_file=False),
    "table": Reader(_table, _read_table, names_file=False),
    "weights": Reader(_weights, read_detector),
    "notes of weights": Reader(_weights, about, names_file=False),
    "checkpoint": Reader(_checkpoint, checkpoint.read),
    "policy": Reader(lambda path: shutil.copy(FOLDER / "prbi-0.safetensors", path), load_policy),
    "records": Reader(_store, _read_store),
}


@pytest.fixture(scope="module")
def valid(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A valid file for each reader."""
    made = {}
    for name, reader in READERS.items():
        made[name] = tmp_path_factory.mktemp("valid") / "file.safetensors"  # the suffix that policies ask for
        reader.write(made[name])
    return made


@pytest.mark.parametrize("name", READERS)
def test_a_valid_file_is_read(name: str, valid: dict[str, Path]) -> None:
    READERS[name].read(valid[name])


@pytest.mark.parametrize("name", READERS)
@given(kind=st.sampled_from(DAMAGE), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=120)
def test_a_damaged_file_is_read_or_refused(name: str, kind: str, seed: int, valid: dict[str, Path]) -> None:
    reader, source = READERS[name], valid[name]
    path = source.with_name("damaged.safetensors")
    path.write_bytes(damaged(source.read_bytes(), kind, random.Random(seed)))
    tracemalloc.start()
    try:
        reader.read(path)
        refused = path.name
    except ValueError as error:
        refused = str(error)
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert peak < MEMORY
    assert len(refused) < 2500, "a sentence, not the file"
    assert not reader.names_file or path.name in refused


@pytest.mark.parametrize("name", [name for name in READERS if name != "table"])
def test_what_is_no_file_of_its_kind(name: str, valid: dict[str, Path], tmp_path: Path) -> None:
    """Empty, a folder, missing, and a hole of 8 GB, of which nothing is read."""
    path = tmp_path / "file.safetensors"
    contents: dict[str, Callable[[], Any]] = {
        "missing": lambda: None,
        "empty": lambda: path.write_bytes(b""),
        "hole": lambda: os.truncate(path, 8 << 30),
        "folder": lambda: (path.unlink(), path.mkdir()),
    }
    if name == "records":
        return
    for content in contents.values():
        content()
        tracemalloc.start()
        with pytest.raises((ValueError, OSError)) as caught:
            READERS[name].read(path)
        assert tracemalloc.get_traced_memory()[1] < MEMORY
        tracemalloc.stop()
        assert isinstance(caught.value, ValueError) or not READERS[name].names_file
