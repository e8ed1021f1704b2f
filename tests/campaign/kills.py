"""Kills: a program is killed again and again at seeded random moments, and goes on to the table of an unkilled run.

A moment is a share of the time that an unkilled run took, or comes shortly after the first frame was encoded. What is
killed is the program, one of its workers, or the process of a sealed defender. A program that is killed leaves no
process behind; one that lost a worker says so, or goes on.
"""

from __future__ import annotations

import functools
import os
import shutil
import signal
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

from tests.campaign import programs
from tests.campaign.case import Case, Fault, Figures
from tests.campaign.processes import Program, started

PART = "kills"
LIMIT = 900.0
"""Seconds that a run may take."""

SEEDS, WORKERS = 2, 2
VICTIMS = {"program": "", "worker": "spawn_main", "sealed": "defenders.sealed.child"}
"""Who is killed, and the words by which its command line is known."""

LATEST = 1.5
"""Seconds after the first encoded frame in which a kill "during encoding" falls."""


@dataclass(frozen=True)
class Setting:
    """What a chain of kills plays. Chains differ in it by their number."""

    program: str
    cold: bool  # the cache is empty at first
    sealed: bool

    @classmethod
    def of(cls, number: int) -> Setting:
        return cls(programs.NAMES[number % 2], number // 2 % 2 == 0, number % 5 == 4)

    def __str__(self) -> str:
        return f"{self.program}, {'cold' if self.cold else 'warm'} cache{', sealed' if self.sealed else ''}"


def cases(kills: int, seed: int, *, chain: int = 5) -> list[Case]:
    """Chains of kills, `kills` in all."""
    sizes = [min(chain, kills - first) for first in range(0, kills, chain)]
    return [
        Case(PART, f"chain {number}, {size} kills, seed {seed}", functools.partial(play, number, size, seed))
        for number, size in enumerate(sizes)
    ]


def play(number: int, kills: int, seed: int, folder: Path) -> Figures:
    """One chain: kill so often, then let the run end, and compare its table.

    Args:
        number: of the chain.
        kills: how many.
        seed: of moments and victims.
        folder: an empty one.

    Returns:
        What was killed how often, the longest that an orphan lived, and the tables that were compared.
    """
    setting, rng = Setting.of(number), Random(f"{seed}-{number}")
    expected, span = reference(setting.program, setting.sealed)
    counts = dict.fromkeys(VICTIMS, 0) | {"encoding": 0, "compared": 0}
    longest, done, out, cache = 0.0, 0, folder / "out", folder / "cache"
    if not setting.cold:
        shutil.copytree(_kept(setting.program, setting.sealed) / "cache", cache)
    while done < kills:
        with running(setting, out, cache, folder) as program:
            victim = rng.choice([name for name in VICTIMS if name != "sealed" or setting.sealed])
            encoding = setting.cold and not any(cache.rglob("*.maps")) and rng.random() < 0.7
            wait_for_the_moment(program, cache if encoding else None, rng.random(), span)
            struck = strike(program, victim, rng)
            if struck is None:  # it had ended before that moment
                compare(setting, program, out, expected)
                counts["compared"] += 1
                clear(out, cache if setting.cold else None)
                continue
            counts[struck] += 1
            counts["encoding"] += int(encoding)
            done += 1
            if struck == "program":
                longest = max(longest, program.check_gone())
            else:
                program.wait(LIMIT)  # it names the failed run, or had none in that worker
    with running(setting, out, cache, folder) as program:
        program.wait(LIMIT)
        compare(setting, program, out, expected)
    counts["compared"] += 1
    return {"kills": done, **counts, "longest_orphan_s": round(longest, 2), "setting": str(setting)}


@contextmanager
def running(setting: Setting, out: Path, cache: Path, folder: Path) -> Iterator[Program]:
    words = programs.arguments(setting.program, out, seeds=SEEDS, workers=WORKERS, sealed=setting.sealed)
    with started(words, folder, env={"CP_ENV_CACHE": str(cache)}) as program:
        yield program


def wait_for_the_moment(program: Program, cache: Path | None, share: float, span: float) -> None:
    """Until that share of an unkilled run's time; with a cache, that share of `LATEST` after its first file."""
    begin = time.monotonic()
    if cache is not None:
        while not program.ended() and not any(cache.rglob("*.maps")):
            time.sleep(0.01)
        begin, span = time.monotonic(), LATEST
    while not program.ended() and time.monotonic() - begin < share * span:
        time.sleep(0.01)


def strike(program: Program, victim: str, rng: Random) -> str | None:
    """Kill the victim, or the program if there is none yet. Who it was; None if the program had ended."""
    if program.ended():
        return None
    found = program.others(VICTIMS[victim]) if VICTIMS[victim] else []
    number, struck = (rng.choice(found), victim) if found else (program.process.pid, "program")
    with suppress(ProcessLookupError):
        os.kill(number, signal.SIGKILL)
    if struck == "program":
        program.process.wait()
    return struck


def compare(setting: Setting, program: Program, out: Path, expected: Any) -> None:
    """Fault unless the program ended well, with that table."""
    if program.wait(LIMIT) != 0:
        raise Fault(f"{setting}: exit status {program.process.returncode}: {program.said()}")
    if programs.table(setting.program, out) != expected:
        raise Fault(f"{setting}: the table differs from that of an unkilled run")
    program.check_gone()


def clear(out: Path, cache: Path | None) -> None:
    for folder in (out, cache):
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)


@functools.cache
def _kept(name: str, sealed: bool) -> Path:
    """The folder of an unkilled run, for as long as this process lives: `out` and `cache`."""
    del name, sealed
    folder = tempfile.TemporaryDirectory(prefix="cp-env-campaign-")
    _folders.append(folder)
    return Path(folder.name)


_folders: list[tempfile.TemporaryDirectory[str]] = []


@functools.cache
def reference(name: str, sealed: bool) -> tuple[Any, float]:
    """The table of an unkilled run, and the seconds it took."""
    folder, setting = _kept(name, sealed), Setting(name, cold=True, sealed=sealed)
    begin = time.monotonic()
    with running(setting, folder / "out", folder / "cache", folder) as program:
        if program.wait(LIMIT) != 0:
            raise Fault(f"an unkilled run failed: {program.said()}")
    return programs.table(name, folder / "out"), time.monotonic() - begin
