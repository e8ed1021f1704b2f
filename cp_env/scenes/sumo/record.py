"""Record scenes: draw streets, let SUMO drive, draw an ego and its company, furnish the streets, store what is near.

    python -m cp_env.scenes.sumo.record --out recordings --seed 0
    python -m cp_env.scenes.sumo.record --regime junction --out recordings/junction --seed 0
    python -m cp_env.scenes.sumo.record --out recordings --describe      # figures of what is there

Needs the extra `sumo`. Scenes are independent of each other; those already in the folder are kept. `regimes` says how
one is drawn.
"""

from __future__ import annotations

import json
import sys
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from cp_env.process import WorkerContext, end_with_parent
from cp_env.progress import say, track
from cp_env.scenes.formats import recording
from cp_env.scenes.sumo.regimes import REGIMES, Pace, pace_of
from cp_env.scenes.town import FAMILIES, INDEX, SPLITS


@dataclass
class Args:
    """Record scenes of traffic, or describe recorded ones."""

    regime: Literal["town", "junction"] = "town"
    """which scenes"""
    out: Path | None = None
    """folder to write to; scenes already there are kept, so a killed run goes on; by default the package's own"""
    seed: int = 0
    """all randomness comes from it"""
    train: int | None = None
    """training scenes of each kind; by default as many as ship, 16 of the town, 40 of the junction"""
    calibration: int | None = None
    """calibration scenes of each kind; by default 4 or 10"""
    test: int | None = None
    """test scenes of each kind; by default 7 or 20"""
    jobs: int = 1
    """processes to share the work; the scenes do not depend on it"""
    describe: bool = False
    """print figures of the scenes in `out` instead of recording"""


COUNTS = {"town": (16, 4, 7), "junction": (40, 10, 20)}  # scenes of each kind, by split


def plan(regime: str, counts: tuple[int, int, int]) -> dict[str, list[str]]:
    """Names of the scenes of each split; `counts` of each kind, by split."""
    kinds = FAMILIES[regime].kinds
    return {s: [f"{s}-{kind}-{k:02d}" for k in range(n) for kind in kinds] for s, n in zip(SPLITS, counts, strict=True)}


def _path(out: Path, name: str) -> Path:
    return out / f"{name}.npz"


def _record(out: Path, name: str, pace: Pace, seed: int) -> None:
    """One scene into its file, in a process of its own (libsumo holds one simulation a process)."""
    import torch

    from cp_env.scenes.sumo.build import record

    torch.set_num_threads(1)
    part = _path(out, name).with_suffix(".part")
    recording.write(part, record(name, REGIMES[name.split("-")[1]], pace, seed))
    part.replace(_path(out, name))


def main(args: Args) -> None:
    """Record what is missing in `args.out`, or describe what is there."""
    from cp_env.scenes.preview.statistics import table

    family = FAMILIES[args.regime]
    out = family.folder if args.out is None else args.out
    if args.describe:
        for split in SPLITS:
            say(table(family(split, out)) + "\n", sys.stdout)
        return
    out.mkdir(parents=True, exist_ok=True)
    train, calibration, test = (
        default if asked is None else asked
        for asked, default in zip((args.train, args.calibration, args.test), COUNTS[args.regime], strict=True)
    )
    names = plan(args.regime, (train, calibration, test))
    wanted = [(name, pace_of(k)) for split in SPLITS for k, name in enumerate(names[split])]
    missing = [(name, pace) for name, pace in wanted if not _path(out, name).exists()]
    with ProcessPoolExecutor(args.jobs, mp_context=WorkerContext(), initializer=end_with_parent) as pool:
        jobs = [pool.submit(_record, out, name, pace, args.seed) for name, pace in missing]
        for job in track(as_completed(jobs), "scenes", len(jobs), "scene"):
            job.result()
    (out / INDEX).write_text(json.dumps(names, indent=1) + "\n")


if __name__ == "__main__":
    import tyro

    main(tyro.cli(Args))
