"""Measure what defenders rest on, with your detector on your scenes: thresholds of similarity, and `bayes`'s densities.

    cp-calibrate                                                               # the shipped detector, the town's scenes
    cp-calibrate --weights runs/mine/mean.safetensors --scenes mine:Folder:folder=data
    cp-calibrate --stages previous_frame --frames 4 --out mine.json            # PRBI's thresholds alone, into a file

Written is one file for each detector, known by the digest of its weights, in your data folder (`CP_ENV_CALIBRATION`
moves it). `prbi:threshold=calibrated`, `robosac:threshold=calibrated`, `pasac` and `bayes` find it by themselves, in
every program. With `--out` it goes elsewhere, and is named: `prbi:threshold=mine.json`, `bayes:likelihood=mine.json`.
A run that was killed goes on with the densities where it stopped. Take other scenes than those that you report on.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from agents.arena.conditions import spread
from agents.calibration.comparisons import STEALTHY, Episodes, folder_of
from agents.calibration.measure import STAGES, Plan, Stage, measure
from agents.commands.common import Victim, run_program
from cp_env.detector.protocol import calibration_digest
from cp_env.paths import cache_directory
from cp_env.progress import say, track
from cp_env.scenes import open_source
from cp_env.world.scene_cache import SceneBank
from defenders.calibration import Calibration, own_file
from defenders.calibration.files import DENSITIES, THRESHOLD_PARTS
from defenders.calibration.lookup import SHIPPED

OF = {
    "previous_frame": "prbi:threshold=calibrated",
    "ego_agreement": "pasac",
    "ego_similarity": "robosac:threshold=calibrated, pasac:score=similarity",
    DENSITIES: "bayes",
}
"""The defenders that rest on each part."""


@dataclass(frozen=True)
class Args(Victim):
    """Measure what defenders rest on."""

    scenes: str = "town/calibration+junction/calibration"
    """a source, none that results are reported on"""
    n_scenes: int | None = None
    """so many of them, spread evenly (all by default)"""
    vehicles: int = 5
    """n, vehicles that share their maps"""
    stages: tuple[Stage, ...] = STAGES
    """what is measured: PRBI's thresholds, those of ROBOSAC and PASAC, bayes's densities"""
    attack: str = "pgd"
    """from whose groups the thresholds are to tell benign ones; also the loud attack of the densities"""
    stealthy: tuple[str, ...] = STEALTHY
    """attacks of the densities that keep each frame similar to the last"""
    previous_frames: int = 6
    """frames of every scene for PRBI's thresholds"""
    ego_frames: int = 4
    """frames of every scene for those of ROBOSAC and PASAC"""
    frames: int = 7
    """frames of every scene for the densities, a benign one first"""
    ages: int = 3
    """frames between a view and its reference, at most, for the densities"""
    seed: int = 0
    out: Path | None = None
    """the file; by default one in your data folder, where defenders find it"""
    shipped: bool = False
    """write the file that ships for this fusion instead: for those who train the shipped weights"""

    def plan(self, names: Sequence[str]) -> Plan:
        """What is measured on scenes of these names."""
        episodes = Episodes(
            n_vehicles=self.vehicles,
            frames=self.frames,
            ages=self.ages,
            loud=self.attack,
            stealthy=self.stealthy,
            seed=self.seed + 7,  # so that the three stages draw different episodes
        )
        return Plan(
            names=spread(names, self.n_scenes),
            stages=self.stages,
            attack=self.attack,
            previous_frames=self.previous_frames,
            ego_frames=self.ego_frames,
            seed=self.seed,
            episodes=episodes,
        )

    def path(self, digest: str) -> Path:
        """Where the calibration of the detector with this digest goes.

        Raises:
            ValueError: two places at once.
        """
        if self.out is not None and self.shipped:
            raise ValueError("--out and --shipped are two places; give one of them")
        return SHIPPED / f"{self.fusion}.json" if self.shipped else self.out or own_file(digest)


def calibrate(args: Args, command: str = "") -> Calibration:
    """Measure and write.

    Args:
        args: of the program.
        command: the file says that it was written by it.

    Returns:
        The calibration.

    Raises:
        ValueError: what `measure` raises, an unknown detector or source, or two places at once.
    """
    bank = SceneBank(open_source(args.scenes), args.open_detector(), progress=False)
    plan, path = args.plan(bank.source.names()), args.path(calibration_digest(bank.detector))
    episodes = ", ".join(f"{stage} {number}" for stage, number in plan.n_episodes.items())
    say(
        f"plan: {sum(plan.n_episodes.values())} episodes ({episodes}) of {len(plan.names)} scenes "
        f"of {bank.source.name}, {plan.n_vehicles} vehicles, one process; "
        "the time left is told after the first episode of a stage"
    )
    folder = cache_directory() / "calibration"
    found = measure(bank, plan, path, folder=folder, command=command, track=_tracked)
    shutil.rmtree(folder_of(bank, plan.episodes, folder), ignore_errors=True)  # only a run that was killed needs it
    return found


def _tracked(items: Sequence[Any], what: str) -> Iterable[Any]:
    return track(items, what, unit="episode")


def table(found: Calibration) -> Table:
    """The thresholds by group size, and which defenders rest on them."""
    parts = [part for part in THRESHOLD_PARTS if part in found.parts]
    sizes = sorted({size for part in parts for size in found.thresholds(part)})
    shown = Table(title=f"ε by the vehicles in a group; detector {found.detector}", box=None, pad_edge=False)
    shown.add_column("part", no_wrap=True)
    for size in sizes:
        shown.add_column(str(size), justify="right", no_wrap=True)
    shown.add_column("rest on it", overflow="fold")
    for part in parts:
        epsilon = found.thresholds(part)
        shown.add_row(part, *(f"{epsilon[size]:.3f}" if size in epsilon else "" for size in sizes), OF[part])
    if DENSITIES in found.parts:
        shown.add_row(DENSITIES, *("" for _ in sizes), OF[DENSITIES])
    return shown


def program(args: Args, command: str) -> None:
    """Measure, write, and say what was found."""
    found = calibrate(args, command)
    Console().print(table(found))
    here = own_file(found.detector)
    use = "defenders find it by themselves" if found.path == here else f"name it: prbi:threshold={found.path}"
    Console().print(f"{found.path}: {use}", soft_wrap=True, highlight=False)


def main(argv: list[str] | None = None) -> None:
    """Run the console script; `argv` are the command line's unless given."""
    run_program("cp-calibrate", Args, program, __doc__, argv)


if __name__ == "__main__":
    main()
