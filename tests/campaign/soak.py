"""The soak: worlds are stepped and reset for a long time, and neither memory nor handles grow.

    python -m tests.campaign.soak --minutes 30 --scenes town/test --out samples.jsonl
    python -m tests.campaign.soak --resets 10_000 --frames 1 --scenes toy --out samples.jsonl

One soak lasts so many minutes, another so many resets, on toy scenes in episodes of one frame. Environments of two
defenders take turns. Sampled are the resident memory, open files, threads, child processes and files of shared memory.
The first half of the time fills the caches, which are bounded; it is not judged.
"""

from __future__ import annotations

import functools
import gc
import json
import mmap
import statistics
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from cp_env.envs.vector import JointAdversaryVectorEnv
from tests.campaign.case import Case, Fault, Figures
from tests.campaign.processes import started

PART = "soak"
DEFENDERS = ("prbi", "bayes")
GROWTH = 0.02
"""Share by which memory may grow from the third to the last quarter of the time: what allocators give and take."""

SHORT = 1
"""Frames of an episode where resets are counted."""

LONGEST = 4 * 3600.0
"""Seconds in which a number of resets must be reached."""

HANDLES = ("files", "threads", "children", "shared")


@dataclass(frozen=True)
class Args:
    """Options of the program."""

    minutes: float = 30.0
    """how long; it counts for nothing if `resets` is given"""
    resets: int | None = None
    """how many resets of single worlds"""
    worlds: int = 16
    frames: int = 3
    """frames of an episode"""
    scenes: str = "town/test"
    """or "toy", which need no detector of the size of ours"""
    seed: int = 0
    samples: int = 200
    """how often is looked"""
    out: Path = Path("samples.jsonl")


@dataclass(frozen=True)
class Sample:
    """What the process holds at one moment."""

    seconds: float
    resets: int  # of single worlds
    frames: int  # of single worlds
    memory_mb: float
    files: int
    threads: int
    children: int
    shared: int


def cases(minutes: float, resets: int, scenes: str, seed: int) -> list[Case]:
    """One soak of so many minutes, and one of so many resets."""
    long = Args(minutes=minutes, scenes=scenes, seed=seed)
    short = Args(resets=resets, frames=SHORT, scenes="toy", seed=seed)
    named = {
        f"{long.worlds} worlds on {scenes}, {minutes:g} minutes, seed {seed}": long,
        f"{short.worlds} worlds on toy, {resets:,} resets of one-frame episodes, seed {seed}": short,
    }
    return [Case(PART, name, functools.partial(play, args)) for name, args in named.items()]


def play(args: Args, folder: Path) -> Figures:
    """One soak in a process of its own; its figures, if nothing grew."""
    samples = folder / "samples.jsonl"
    words = ["-m", "tests.campaign.soak"]
    for name, value in asdict(replace(args, out=samples)).items():
        words += [] if value is None else [f"--{name}", str(value)]
    with started(words, folder, env={"CP_ENV_CACHE": str(folder / "cache")}) as program:
        if program.wait(args.minutes * 60 * 2 + 900 if args.resets is None else LONGEST) != 0:
            raise Fault(f"the soak ended with {program.process.returncode}: {program.said()}")
    found = [Sample(**json.loads(line)) for line in samples.read_text().splitlines()]
    if args.resets is not None and found[-1].resets < args.resets:
        raise Fault(f"{found[-1].resets:,} resets, not {args.resets:,}")
    return judged(found)


def judged(samples: Sequence[Sample]) -> Figures:
    """The figures of a soak. Fault if memory or handles grew in its second half."""
    half = [sample for sample in samples if sample.seconds >= samples[-1].seconds / 2]
    middle = len(half) // 2
    third, last = ([s.memory_mb for s in part] for part in (half[:middle], half[middle:]))
    before, after = statistics.median(third), statistics.median(last)
    hours = np.array([sample.seconds / 3600 for sample in half])
    slope = float(np.polyfit(hours - hours[0], [sample.memory_mb for sample in half], 1)[0]) if middle else 0.0
    if after > before * (1 + GROWTH):
        raise Fault(f"memory grew from {before:.1f} to {after:.1f} MB in the second half ({slope:.1f} MB an hour)")
    for name in HANDLES:
        numbers = [getattr(sample, name) for sample in half]
        if max(numbers[middle:]) > max(numbers[:middle]):
            raise Fault(f"{name} grew from {max(numbers[:middle])} to {max(numbers[middle:])} in the second half")
    end = samples[-1]
    return {
        "minutes": round(end.seconds / 60, 1),
        "resets": end.resets,
        "frames": end.frames,
        "memory_mb": round(after, 1),
        "highest_mb": round(max(sample.memory_mb for sample in samples), 1),
        "slope_mb_per_hour": round(slope, 1),
        **{name: getattr(end, name) for name in HANDLES},
    }


def soak(args: Args) -> Iterator[Sample]:
    """Step the environments in turns, an episode each; a sample now and then."""
    options: dict[str, Any] = {"max_frames": args.frames, "action": "basis"}
    if args.scenes == "toy":
        from tests.helpers.toy_evaluation import toy_bank

        options["bank"] = toy_bank()
    else:
        options["scenes"] = args.scenes
    made = [JointAdversaryVectorEnv(args.worlds, defender, **options) for defender in DEFENDERS]
    for number, env in enumerate(made):
        env.reset(seed=args.seed + 1000 * number)
        env.action_space.seed(args.seed)
    begin, seen = time.monotonic(), 0.0
    resets, frames, share = args.worlds * len(made), 0, 0.0
    while share < 1:
        for env in made:
            for _ in range(args.frames):
                truncated = env.step(env.action_space.sample())[3]
                resets, frames = resets + int(truncated.sum()), frames + args.worlds
        seconds = time.monotonic() - begin
        share = seconds / (60 * args.minutes) if args.resets is None else resets / args.resets
        if share >= min(seen + 1 / args.samples, 1):
            seen = share
            yield _sample(seconds, resets, frames)
    for env in made:
        env.close()


def _sample(seconds: float, resets: int, frames: int) -> Sample:
    gc.collect()
    own = Path("/proc/self")
    memory = int((own / "statm").read_text().split()[1]) * mmap.PAGESIZE / 2**20
    threads = [entry.name for entry in (own / "task").iterdir()]
    children = sum(len((own / "task" / name / "children").read_text().split()) for name in threads)
    counted = [len(list(folder.iterdir())) for folder in (own / "fd", Path("/dev/shm"))]
    return Sample(round(seconds, 1), resets, frames, round(memory, 2), counted[0], len(threads), children, counted[1])


def main(args: Args) -> None:
    """Run the soak, and write every sample at once."""
    with args.out.open("w") as lines:
        for sample in soak(args):
            lines.write(json.dumps(asdict(sample)) + "\n")
            lines.flush()


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
