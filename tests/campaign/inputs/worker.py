"""Tries inputs in a process of its own, so that a crash of the interpreter is seen.

    python -m tests.campaign.inputs.worker FAMILY SEED FIRST COUNT FOLDER

The number of the input in work is in the file `now` of the folder before it is tried; what came of all is in `found` at
the end. Input number i of a family depends on the seed, the family and i alone.
"""

from __future__ import annotations

import json
import mmap
import resource
import struct
import sys
import traceback
import warnings
from pathlib import Path
from random import Random
from typing import Any

import torch

from tests.campaign.inputs.families import FAMILIES
from tests.campaign.inputs.trial import Family

MEMORY = 1 << 30
"""Bytes that trying inputs may take beside what the programs take anyway."""

FAULTS = 10
"""Faults after which a worker stops."""

NOW = struct.Struct("<Q")


def bound_memory(more: int = MEMORY) -> None:
    """Let an allocation beyond what is taken now fail, if it is by so much."""
    taken = int(Path("/proc/self/statm").read_text().split()[0]) * mmap.PAGESIZE
    hard = resource.getrlimit(resource.RLIMIT_AS)[1]
    wanted = taken + more if hard == resource.RLIM_INFINITY else min(taken + more, hard)
    resource.setrlimit(resource.RLIMIT_AS, (wanted, hard))


def resident() -> int:
    """Bytes in memory now."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * mmap.PAGESIZE


def run(name: str, seed: int, first: int, count: int, folder: Path, families: dict[str, Family] = FAMILIES) -> Any:
    """Try so many inputs of a family. Returns what came of them, fit for JSON."""
    family = families[name]
    work = folder / "work"
    work.mkdir()
    tried, taken, faults = 0, 0, list[str]()
    with (folder / "now").open("w+b") as file, warnings.catch_warnings():
        file.write(NOW.pack(first))
        file.flush()
        now = mmap.mmap(file.fileno(), NOW.size)
        one = family.prepare(work)
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", category=DeprecationWarning)
        bound_memory()
        begin, peak = resident(), resident()
        for number in range(first, first + count):
            NOW.pack_into(now, 0, number)
            tried += 1
            try:
                taken += int(one(Random(f"{seed}-{name}-{number}")))
            except family.refusals:
                pass
            except Exception as error:
                where = "".join(traceback.format_exception(error, limit=-3))[-1200:]
                faults.append(f"input {number} of {name}, seed {seed}: {type(error).__name__}: {where}")
                if len(faults) == FAULTS:
                    break
            if number % 256 == 0:
                peak = max(peak, resident())
    more = round((max(peak, resident()) - begin) / 2**20, 1)
    return {"inputs": tried, "taken": taken, "refused": tried - taken - len(faults), "faults": faults, "grown_mb": more}


def main(words: list[str]) -> None:
    """Run the worker."""
    torch.set_num_threads(1)
    name, seed, first, count, folder = words
    found = run(name, int(seed), int(first), int(count), Path(folder))
    (Path(folder) / "found").write_text(json.dumps(found))


if __name__ == "__main__":
    main(sys.argv[1:])
