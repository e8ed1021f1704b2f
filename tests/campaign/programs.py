"""`cp-arena` and the benchmark on toy scenes (`--scenes toy:any`) under a toy detector, each as a process of its own.

python -m tests.campaign.programs arena ARGUMENTS
python -m tests.campaign.programs benchmark ARGUMENTS
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tests.helpers import toy_arena

NAMES = ("arena", "benchmark")
COMMON = ("--scenes", "toy:any", "--frames", "3", "--batch", "1", "--defenders", "none", "prbi")
ATTACKS = ("--attacks", "none", "pgd:steps=1")
QUIET = {"arena": ("--no-videos",), "benchmark": ("--no-gif", "--ks", "2")}


def arguments(name: str, out: Path, *, seeds: int, workers: int, sealed: bool = False) -> list[str]:
    """What `python` is given to run the program on so many seeds."""
    numbers = [str(seed) for seed in range(seeds)]
    rest = ["--seeds", *numbers, "--workers", str(workers), "--out", str(out), *(["--sealed"] if sealed else [])]
    return ["-m", "tests.campaign.programs", name, *COMMON, *ATTACKS, *QUIET[name], *rest]


TIMES = ("frames_per_second", "milliseconds", "late")
"""Fields of results that depend on how fast the machine was."""


def table(name: str, out: Path) -> Any:
    """All results that the program wrote, but times and the command."""
    found: dict[str, Any] = json.loads((out / {"arena": "arena.json", "benchmark": "results.json"}[name]).read_text())
    return _untimed({**found, "about": None})


def _untimed(thing: Any) -> Any:
    if isinstance(thing, dict):
        return {key: _untimed(value) for key, value in thing.items() if key not in TIMES}
    return [_untimed(one) for one in thing] if isinstance(thing, list) else thing


def main(words: Sequence[str]) -> None:
    """Run one of the programs."""
    name, *rest = words
    if name == "arena":
        from agents.arena import cli

        cli.draw_plots = lambda results: {}  # matplotlib takes seconds
        cli.main(rest)
    elif name == "benchmark":
        from agents.commands import benchmark

        benchmark.main(rest)
    else:
        raise SystemExit(f"the programs are {', '.join(NAMES)}, not {name!r}")


if __name__ in ("__main__", "__mp_main__"):  # its workers, too
    toy_arena.install()

if __name__ == "__main__":
    main(sys.argv[1:])
