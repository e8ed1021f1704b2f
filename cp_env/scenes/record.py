"""Record scenes: draw streets, let SUMO drive, choose an ego and its company, furnish the streets, store what is near.

    python -m cp_env.scenes.record --out recordings --seed 0
    python -m cp_env.scenes.record --out recordings --describe      # figures of what is there

Needs the extra `sumo`. Scenes are independent of each other; those already in the folder are kept.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from cp_env.scenes import recording
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
    describe: bool = False
    """print figures of the scenes in `out` instead of recording"""


def plan(train: int, calibration: int, test: int) -> dict[str, list[str]]:
    """Names of the scenes of each split."""
    counts = dict(zip(SPLITS, (train, calibration, test), strict=True))
    return {split: [f"{split}-{kind}-{k:02d}" for k in range(n) for kind in KINDS] for split, n in counts.items()}


def main(args: Args) -> None:
    """Record what is missing in `args.out`, or describe what is there."""
    import torch
    from tqdm import tqdm

    from cp_env.scenes.describe import table
    from cp_env.scenes.staging import record

    torch.set_num_threads(1)
    if args.describe:
        for split in SPLITS:
            tqdm.write(table(Town(split, args.out)) + "\n")
        return
    args.out.mkdir(parents=True, exist_ok=True)
    names = plan(args.train, args.calibration, args.test)
    for name in tqdm([name for split in SPLITS for name in names[split]], desc="scenes", unit="scene"):
        path = args.out / f"{name}.npz"
        if not path.exists():
            part = path.with_suffix(".part")
            recording.write(part, record(name, name.split("-")[1], args.seed))
            part.replace(path)
    (args.out / INDEX).write_text(json.dumps(names, indent=1) + "\n")


if __name__ == "__main__":
    import tyro

    main(tyro.cli(Args))
