"""Damaged files for every reader, and stored runs that were rewritten with a checksum that fits."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from agents.arena.conditions import read_key
from cp_env.evaluation import Store, summarise
from cp_env.evaluation.plan.checksum import Fault, stamp
from cp_env.scenes.formats.bounded import read_bytes
from cp_env.scenes.opv2v import bounded_yaml
from cp_env.scenes.sumo import xml_files
from cp_env.world.block_file import read_chunk, write_block
from cp_env.world.packing import pack_array, pack_map, unpack_array, unpack_map
from tests.campaign.inputs.trial import Try
from tests.cp_env.scenes.formats.test_readers import DAMAGE, READERS, RECORDS, Reader, damaged
from tests.helpers.toy_evaluation import CONDITIONS, RUNS

MAP = np.where(np.arange(8 * 9 * 9) % 3, 0, np.arange(8 * 9 * 9) / 50).astype(np.float16).reshape(8, 9, 9)
YAML = "true_ego_pos: &a [1.5, 2, -3e2]\nvehicles:\n  12: {angle: [0, 1], extent: *a, speed: 3}\n  13: null\n"
XML = '<configuration><input><net-file value="a.net.xml"/></input><time><begin value="3"/></time></configuration>'

MORE = {
    "yaml": Reader(lambda p: p.write_text(YAML), lambda p: bounded_yaml.load(read_bytes(p, bounded_yaml.MAX_BYTES))),
    "xml": Reader(lambda p: p.write_text(XML), xml_files.parse),
    "key": Reader(lambda p: p.write_text("0123456789abcdef" * 3), read_key),
    "block": Reader(lambda p: write_block(p, [pack_map(MAP), b"x" * 50, b""]), lambda p: read_chunk(p, 1, 3)),
    "map": Reader(lambda p: p.write_bytes(pack_map(MAP)), lambda p: unpack_map(p.read_bytes(), MAP.shape)),
    "array": Reader(lambda p: p.write_bytes(pack_array(MAP)), lambda p: unpack_array(p.read_bytes())),
}
"""Readers beside those of `test_readers`."""

ALL = {**READERS, **MORE}


def files(folder: Path) -> Try:
    """One to three small damages of a valid file, for every reader."""
    valid: dict[str, bytes] = {}
    for name, reader in ALL.items():
        place = folder / name.replace(" ", "-")
        place.mkdir()
        reader.write(place / "file.safetensors")
        valid[name] = (place / "file.safetensors").read_bytes()

    def one(rng: Random) -> bool:
        name = rng.choice(list(ALL))
        data = valid[name]
        for _ in range(rng.randint(1, 3)):
            data = damaged(data or b"\0", rng.choice(DAMAGE), rng)[: 1 << 20]
        path = folder / name.replace(" ", "-") / "file.safetensors"
        path.write_bytes(data)
        ALL[name].read(path)
        return True

    return one


STRANGE: tuple[Callable[[], Any], ...] = (
    lambda: None,
    lambda: True,
    lambda: -1,
    lambda: 10**30,
    lambda: 1e308,
    lambda: float("nan"),
    lambda: "",
    lambda: "\ud800",
    lambda: "A" * 3000,
    list,
    dict,
    lambda: [[[[]]]],
    lambda: {"boxes": {}},
)


def records(folder: Path) -> Try:
    """Stored runs with values changed, and a checksum that fits: they are found out, or counted without a crash."""
    store, run = Store(folder), RUNS[0]
    store.write(run, CONDITIONS, RECORDS)
    path = store.path(run, CONDITIONS)
    text = path.read_text()

    def one(rng: Random) -> bool:
        content = json.loads(text)
        content.pop("checksum")
        name = content.pop("name")
        for _ in range(rng.randint(1, 3)):
            change(content, rng)
        path.write_text(stamp(name, content), encoding="utf-8", errors="surrogatepass")
        if isinstance(found := store.examine(run, CONDITIONS), Fault):
            return False
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if found is not None and rng.random() < 0.05:
                summarise({run: list(found)}, resamples=2)
        return True

    return one


def change(content: Any, rng: Random) -> None:
    """Change one value somewhere in a JSON value."""
    here = content
    while True:
        keys: list[Any] = list(here) if isinstance(here, dict) else list(range(len(here)))
        if not keys:
            return
        key = rng.choice(keys)
        if isinstance(here[key], dict | list) and rng.random() < 0.85:
            here = here[key]
            continue
        kind = rng.random()
        if kind < 0.15 and isinstance(here, dict):
            del here[key]
        elif kind < 0.3 and isinstance(here[key], int | float):
            here[key] += rng.choice([1, -1, 0.5, 10**6])
        elif kind < 0.4 and isinstance(here, list):
            here.append(here[key])
        else:
            here[key] = rng.choice(STRANGE)()
        return
