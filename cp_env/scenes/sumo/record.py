"""Record scenes: draw streets, let SUMO drive, choose an ego and its company, furnish the streets, store what is near.

    python -m cp_env.scenes.sumo.record --out recordings --seed 0
    python -m cp_env.scenes.sumo.record --out recordings --describe      # figures of what is there

Needs the extra `sumo`. Scenes are independent of each other; those already in the folder are kept.
"""

from __future__ import annotations

import json
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

from cp_env.scenes.formats import recording
from cp_env.scenes.town import DATA, INDEX, KINDS, SPLITS, Town


@dataclass
class Args:
    """Record scenes of traffic, or describe recorded ones."""

    out: Path = DATA
    """folder to write to; scenes already there are kept, so a killed run goes on"""
    seed: int = 0
    """all randomness comes from it"""
    train: int = 16
    """training scenes of each kind"""
    calibration: int = 4
    """calibration scenes of each kind"""
    test: int = 7
    """test scenes of each kind"""
    jobs: int = 1
    """processes to share the work; the scenes do not depend on it"""
    describe: bool = False
    """print figures of the scenes in `out` instead of recording"""


def plan(train: int, calibration: int, test: int) -> dict[str, list[str]]:
    """Names of the scenes of each split."""
    counts = dict(zip(SPLITS, (train, calibration, test), strict=True))
    return {split: [f"{split}-{kind}-{k:02d}" for k in range(n) for kind in KINDS] for split, n in counts.items()}


def _path(out: Path, name: str) -> Path:
    return out / f"{name}.npz"


def _record(out: Path, name: str, seed: int) -> None:
    """One scene into its file, in a process of its own (libsumo holds one simulation a process)."""
    import torch

    from cp_env.scenes.sumo.build import record

    torch.set_num_threads(1)
    part = _path(out, name).with_suffix(".part")
    recording.write(part, record(name, name.split("-")[1], seed))
    part.replace(_path(out, name))


def main(args: Args) -> None:
    """Record what is missing in `args.out`, or describe what is there."""
    from tqdm import tqdm

    from cp_env.scenes.preview.statistics import table

    if args.describe:
        for split in SPLITS:
            tqdm.write(table(Town(split, args.out)) + "\n")
        return
    args.out.mkdir(parents=True, exist_ok=True)
    names = plan(args.train, args.calibration, args.test)
    missing = [name for split in SPLITS for name in names[split] if not _path(args.out, name).exists()]
    with ProcessPoolExecutor(args.jobs, mp_context=get_context("spawn")) as pool:
        jobs = [pool.submit(_record, args.out, name, args.seed) for name in missing]
        for job in tqdm(as_completed(jobs), total=len(jobs), desc="scenes", unit="scene"):
            job.result()
    (args.out / INDEX).write_text(json.dumps(names, indent=1) + "\n")


if __name__ == "__main__":
    import tyro

    main(tyro.cli(Args))
