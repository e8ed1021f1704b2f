"""All parts of a calibration, measured with one detector on one source of scenes and put into one file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

from agents.calibration import comparisons, densities, ego_view, previous_frame
from agents.calibration.comparisons import Episodes
from agents.calibration.densities import Smoothing
from agents.calibration.samples import Track
from cp_env.detector.protocol import calibration_digest, fusion_of
from cp_env.world.scene_cache import SceneBank
from defenders.bayes.histograms import likelihood_of
from defenders.calibration import Calibration, write_part
from defenders.calibration.files import DENSITIES

Stage = Literal["previous_frame", "ego_view", "densities"]
STAGES: tuple[Stage, ...] = get_args(Stage)
"""What is measured, one after the other; the second gives two parts."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What is measured, and how long.

    Attributes:
        names: scenes of the source.
        stages: some of `STAGES`.
        attack: of the attackers whose groups the thresholds are to tell from benign ones.
        previous_frames: frames of every scene for PRBI's thresholds; the first is the reference of the second.
        ego_frames: frames of every scene for the thresholds of ROBOSAC and PASAC.
        seed: of both.
        episodes: what `bayes` is measured on.
        smoothing: of its densities.

    Raises:
        ValueError: an unknown stage, or too few vehicles, frames or scenes.
    """

    names: tuple[str, ...]
    stages: tuple[str, ...] = STAGES
    attack: str = "pgd"
    previous_frames: int = 11
    ego_frames: int = 6
    seed: int = 0
    episodes: Episodes = field(default_factory=Episodes)
    smoothing: Smoothing = field(default_factory=Smoothing)

    def __post_init__(self) -> None:
        if strange := [stage for stage in self.stages if stage not in STAGES]:
            raise ValueError(f"unknown stage {strange[0]!r} of a calibration; known: {', '.join(STAGES)}")
        if not self.names or not self.stages:
            raise ValueError("a calibration needs at least one scene and one stage")
        if self.n_vehicles < 2:
            raise ValueError(f"n_vehicles must be at least 2 to compare groups, not {self.n_vehicles}")
        least = {"previous_frames": (self.previous_frames, 2), "ego_frames": (self.ego_frames, 1)}
        least["frames of densities"] = (self.episodes.frames, max(self.episodes.ages + 1, 3))
        for what, (frames, fewest) in least.items():
            if frames < fewest:
                raise ValueError(f"{what} must be at least {fewest}, not {frames}")

    @property
    def n_vehicles(self) -> int:
        return self.episodes.n_vehicles

    @property
    def n_episodes(self) -> dict[str, int]:
        """Episodes of each stage that is measured."""
        n, attacks = self.n_vehicles, 1 + len(self.episodes.stealthy)
        each: dict[str, int] = dict(zip(STAGES, (n, n, 1 + attacks * (n - 1)), strict=True))
        return {stage: len(self.names) * each[stage] for stage in self.stages}


def measure(bank: SceneBank, plan: Plan, path: Path, *, folder: Path, command: str, track: Track[Any]) -> Calibration:
    """Measure, and write each part when it is done; parts of the file that are not measured stay.

    Args:
        bank: scenes and detector.
        plan: what is measured.
        path: of the calibration file.
        folder: for measurements that are kept while the run lasts.
        command: what the file says that it was written by.
        track: shows the progress over episodes.

    Returns:
        The calibration.

    Raises:
        ValueError: scenes with fewer vehicles or frames than the plan needs, or in which the detector finds too little
            to compare.
    """
    detector = bank.detector
    digest, fusion = calibration_digest(detector), str(fusion_of(detector, "mean"))
    _check_scenes(bank, plan)

    def write(part: str, frames: int, attacks: str, content: Mapping[str, Any]) -> Calibration:
        source = f"{bank.source.name}, {len(plan.names)} scenes, detector {digest}, {attacks}, {frames} frames a scene"
        return write_part(path, digest, fusion, part, {"source": source, "command": command, **content})

    common: dict[str, Any] = {"n_vehicles": plan.n_vehicles, "attack": plan.attack, "seed": plan.seed, "track": track}
    if "previous_frame" in plan.stages:
        samples = previous_frame.survey(bank, plan.names, frames=plan.previous_frames, **common)
        epsilon = previous_frame.thresholds(samples, plan.n_vehicles)
        found = write("previous_frame", plan.previous_frames, plan.attack, {"epsilon": epsilon})
    if "ego_view" in plan.stages:
        for score, of_score in ego_view.survey(bank, plan.names, frames=plan.ego_frames, **common).items():
            epsilon = ego_view.thresholds(of_score, plan.n_vehicles)
            found = write(f"ego_{score}", plan.ego_frames, plan.attack, {"epsilon": epsilon})
    if "densities" in plan.stages:
        episodes = plan.episodes
        values = densities.by_kind(comparisons.survey(bank, plan.names, episodes, folder, track), episodes)
        rows = densities.densities(values, plan.n_vehicles, plan.smoothing)
        content = densities.part_of(rows, episodes, plan.smoothing.tail)
        likelihood_of(content)
        found = write(DENSITIES, episodes.frames, " ".join([episodes.loud, *episodes.stealthy]), content)
    return found


def _check_scenes(bank: SceneBank, plan: Plan) -> None:
    """ValueError unless every scene has the vehicles and the frames, and something is found in one of them."""
    wanted: dict[str, int] = {"previous_frame": 2, "ego_view": 1, "densities": max(plan.episodes.ages + 1, 3)}
    least, boxes = max(wanted[stage] for stage in plan.stages), 0
    for name in plan.names:
        episode = bank.episode(name, plan.n_vehicles, False)
        if episode.scene.n_frames < least:
            raise ValueError(f"scene {name} has {episode.scene.n_frames} frames, and at least {least} are compared")
        boxes += len(episode.clean_views[0].seen.boxes)
    if not boxes:
        raise ValueError(
            "the detector finds nothing in the first frames of these scenes at its operating threshold "
            f"{bank.detector.threshold:g}, so there is nothing to compare: train it longer, or choose the threshold by "
            "cp-env evaluate --weights FILE --scenes … --calibrate"
        )
