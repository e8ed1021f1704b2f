"""Programs in processes of their own: started with a mark, found by it, killed, and looked for afterwards (Linux)."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from tests.campaign.case import Fault

ROOT = Path(__file__).parents[2]
MARK = "CP_ENV_CAMPAIGN"
"""An environment variable that every process of a program inherits."""

GONE = 10.0
"""Seconds after which no process of a killed program may live."""


@dataclass(frozen=True)
class Program:
    """A running program, with everything that it started."""

    process: subprocess.Popen[bytes]
    mark: str
    log: Path

    def family(self) -> list[int]:
        """Numbers of all processes that bear the mark and live, the program's own included."""
        return [number for number in _numbers() if self.mark in _environment(number) and alive(number)]

    def others(self, words: str) -> list[int]:
        """Those of the family, but the program itself, whose command line holds the words."""
        return sorted(n for n in self.family() if n != self.process.pid and words in command_line(n))

    def ended(self) -> bool:
        return self.process.poll() is not None

    def wait(self, limit: float) -> int:
        """Its exit status. Fault if it does not end in time."""
        try:
            return self.process.wait(limit)
        except subprocess.TimeoutExpired:
            raise Fault(f"it did not end within {limit:.0f} s: {self.said()}") from None

    def said(self) -> str:
        """The end of what it printed."""
        return self.log.read_text(encoding="utf-8", errors="replace")[-1500:]

    def check_gone(self, limit: float = GONE) -> float:
        """Seconds until none of the family lives. Fault if one outlives the limit."""
        begin = time.monotonic()
        while left := self.family():
            if time.monotonic() - begin > limit:
                lines = "; ".join(f"{number}: {command_line(number)[:200]}" for number in left)
                raise Fault(f"orphans after {limit:.0f} s: {lines}")
            time.sleep(0.02)
        return time.monotonic() - begin


@contextmanager
def started(
    arguments: Sequence[str], folder: Path, *, env: dict[str, str] | None = None, name: str = "log"
) -> Iterator[Program]:
    """`python ARGUMENTS` from the root of the tree; whatever of it still lives afterwards is killed."""
    mark = uuid.uuid4().hex
    variables = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "MPLBACKEND": "Agg", MARK: mark}
    variables["NO_COLOR"] = "1"
    log = folder / f"{name}-{mark[:6]}.txt"
    with log.open("wb") as said:
        process = subprocess.Popen(
            [sys.executable, *arguments],
            cwd=ROOT,
            env={**variables, **(env or {})},
            stdin=subprocess.DEVNULL,
            stdout=said,
            stderr=subprocess.STDOUT,
        )
        program = Program(process, mark, log)
        try:
            yield program
        finally:
            for number in program.family():
                with suppress(ProcessLookupError):
                    os.kill(number, signal.SIGKILL)
            process.wait()


def alive(number: int) -> bool:
    """Whether the process lives; a zombie does not."""
    try:
        return Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


def command_line(number: int) -> str:
    try:
        return Path(f"/proc/{number}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
    except OSError:
        return ""


def _environment(number: int) -> str:
    try:
        return Path(f"/proc/{number}/environ").read_bytes().decode(errors="replace")
    except OSError:
        return ""


def _numbers() -> list[int]:
    return [int(entry.name) for entry in Path("/proc").iterdir() if entry.name.isdecimal()]
