"""Inputs: what nobody should give is refused by a documented error. No other one, no crash, no hang, bounded memory."""

from __future__ import annotations

import functools
import json
import math
import time
from pathlib import Path

from tests.campaign.case import Case, Fault, Figures
from tests.campaign.inputs.families import FAMILIES
from tests.campaign.inputs.worker import NOW
from tests.campaign.processes import Program, started

PART = "inputs"
HANGS = 120.0
"""Seconds without a new input after which one is said to hang."""

BEGINS = 300.0
"""Seconds in which a worker must have begun, and in which it must have ended after its last input."""


def cases(inputs: int, seed: int) -> list[Case]:
    """Chunks of every family, about `inputs` in all."""
    planned: list[tuple[float, Case]] = []
    for name, family in FAMILIES.items():
        left = max(1, round(inputs * family.share))
        for number in range(math.ceil(left / family.chunk)):
            count = min(family.chunk, left - number * family.chunk)
            what = f"{name}, {count} from {number * family.chunk}, seed {seed}"
            case = Case(PART, what, functools.partial(play, name, seed, number * family.chunk, count))
            planned.append(((number + 1) * family.chunk / family.share, case))
    return [case for _, case in sorted(planned, key=lambda pair: pair[0])]  # all families go ahead alike


def play(name: str, seed: int, first: int, count: int, folder: Path) -> Figures:
    """Try a chunk in a worker.

    Args:
        name: of the family.
        seed: of the inputs.
        first: number of the first.
        count: how many.
        folder: an empty one.

    Returns:
        How many were tried, taken and refused, and how many MB the worker grew.
    """
    words = ["-X", "faulthandler", "-m", "tests.campaign.inputs.worker", name, *map(str, (seed, first, count, folder))]
    begin = time.monotonic()
    with started(words, folder, env={"CP_ENV_CACHE": str(folder / "cache")}) as program:
        _watch(program, folder, f"{name}, seed {seed}")
        if program.process.returncode != 0:
            raise Fault(f"the worker ended in input {_now(folder)} of {name}, seed {seed}: {program.said()}")
    found = json.loads((folder / "found").read_text())
    if found["faults"]:
        raise Fault(f"{len(found['faults'])} errors that are not documented: " + "\n".join(found["faults"]))
    seconds = round(time.monotonic() - begin, 1)
    return {
        "family": name,
        **{key: found[key] for key in ("inputs", "taken", "refused", "grown_mb")},
        "wall_s": seconds,
    }


def _watch(program: Program, folder: Path, what: str) -> None:
    """Wait for the worker; Fault if an input takes too long."""
    last, since, begun = -1, time.monotonic(), False
    while not program.ended():
        now = _now(folder)
        if now != last:
            begun = begun or (last >= 0)
            last, since = now, time.monotonic()
        elif time.monotonic() - since > (HANGS if begun and not (folder / "found").exists() else BEGINS):
            raise Fault(f"input {now} of {what} hangs: no answer for {time.monotonic() - since:.0f} s")
        time.sleep(0.05)


def _now(folder: Path) -> int:
    """The number of the input in work; -1 before the first."""
    try:
        data = (folder / "now").read_bytes()
    except FileNotFoundError:
        return -1
    return int(NOW.unpack(data)[0]) if len(data) == NOW.size else -1
