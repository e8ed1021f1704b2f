"""What is known of a frame before anyone acts, and after everyone judged."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, Shaped
from torch import Tensor

from cp_env.detector.model.decoder import Dense
from cp_env.detector.protocol import DetectorLike, with_ego_context
from cp_env.metrics.driving import DrivingMeasures
from cp_env.metrics.surroundings import Surroundings, frozen_scene, surroundings
from cp_env.types import Scene, View, frozen
from cp_env.world.episode import Episode
from cp_env.world.verification import Judgement
from defenders.protocol import Verdict

Clock = Callable[[], float]


@dataclass(frozen=True, eq=False)
class Situation:
    """The current frame before anyone acts: all that a white-box attack may know. First axis: worlds.

    That includes the defence, by what the ego did in the last frame (`output`, `verdict`) and by `simulate`: the
    outcome of a δ if it were played now. It is judged by copies of the defenders, their algorithm and state. Their
    random numbers come from the attack's own generators, one a world. No defender changes by it.
    """

    features: Callable[[], Float[Tensor, "E N C H W"]]  # encoded maps, sender frames; read on demand
    receive: Callable[[], Float[Tensor, "E N C H W"]]  # see `received`
    coverage: Float[Tensor, "E N H W"]
    ego_T_sender: Float[Tensor, "E N 3"]  # m, m, rad
    perceive_clean: Callable[[], Dense]  # see `clean`
    attackers: Int[Tensor, "E k"]
    fused: Bool[Tensor, "E N"]  # expected collaborators: all, until a verdict that has converged leaves some out
    present: Bool[Tensor, "E N"]  # vehicles that send a map; perturbations of others are dropped
    active: Bool[Tensor, " E"]  # False in grace frames: perturbations are dropped
    frame: Int[np.ndarray, " E"]  # since the episode began
    budget: float  # Δ
    norm: str
    detector: DetectorLike
    place: Float[np.ndarray, "E 2"]  # where the egos stand in the world; m
    heading: Float[np.ndarray, " E"]  # which way they face there; rad
    output: tuple[View | None, ...]  # what they acted on in the last frame; None in the first
    verdict: tuple[Verdict | None, ...]  # of the last frame
    simulate: Callable[[Float[Tensor, "E k C H W"], Sequence[np.random.Generator]], SimulatedOutcome]
    ego_context: Shaped[Tensor, "E ..."] | None = None  # of the egos, if the detector uses it

    @property
    def received(self) -> Float[Tensor, "E N C H W"]:
        """All maps in the ego frame, before any perturbation; read when they are first asked for."""
        return self.receive()

    @property
    def clean(self) -> Dense:
        """The decoder's output with everyone fused and no attack; read when it is first asked for."""
        return self.perceive_clean()

    @property
    def device(self) -> torch.device:
        """Where maps and perturbations are."""
        return self.coverage.device

    @property
    def delta_shape(self) -> tuple[int, int, int, int, int]:
        """[E, k, C, H, W]: the shape of δ."""
        (worlds, k), size = self.attackers.shape, self.coverage.shape[-1]
        return worlds, k, self.detector.channels, size, size

    def handed_out(
        self, receive: Callable[[], Float[Tensor, "E N C H W"]], perceive_clean: Callable[[], Dense]
    ) -> Situation:
        """The same with copies of all tensors and arrays: what an attack does to them changes nothing here.

        Args:
            receive: gives the maps in the ego frame, nobody else's.
            perceive_clean: gives the clean output, nobody else's.
        """
        copies: dict[str, Any] = {"receive": receive, "perceive_clean": perceive_clean}
        for one in fields(self):
            value = getattr(self, one.name)
            if isinstance(value, Tensor):
                copies[one.name] = value.clone()
            elif isinstance(value, np.ndarray):
                copies[one.name] = value.copy()
        copies["output"] = tuple(view and view.twin() for view in self.output)
        copies["verdict"] = tuple(verdict and copy.copy(verdict) for verdict in self.verdict)
        return replace(self, **copies)

    def ego_detector(self, worlds: Int[Tensor, " B"] | slice = slice(None)) -> DetectorLike:
        """The detector bound to the ego context of `worlds`: for rows of `received[worlds]`."""
        return with_ego_context(self.detector, None if self.ego_context is None else self.ego_context[worlds])


@dataclass(frozen=True, eq=False, kw_only=True)
class SimulatedOutcome:
    """A frame of every world, after the defenders judged it, as an attack may know it: without the ground truth.

    Sequences and first axes run over worlds. All arrays are read-only.
    """

    frame: Int[np.ndarray, " E"]
    seen: tuple[View, ...]  # everyone fused, attackers included
    clean: tuple[View, ...]  # everyone fused, as it would have been without the attack
    judgements: tuple[Judgement, ...]
    similarity: Float[np.ndarray, " E"]  # Eq. (5) of `seen` to the previous output; 1 in the first frame
    damage: Float[np.ndarray, " E"]  # 1 - Jaccard(output, clean)
    perturbation_norm: Float[np.ndarray, "E k"]
    attackers: Int[np.ndarray, "E k"]
    truncated: Bool[np.ndarray, " E"]

    def __post_init__(self) -> None:
        for one in fields(self):
            value = getattr(self, one.name)
            if isinstance(value, np.ndarray):
                object.__setattr__(self, one.name, frozen(value))

    @property
    def output(self) -> tuple[View, ...]:
        """What the ego acts on."""
        return tuple(judgement.output for judgement in self.judgements)

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        return tuple(judgement.verdict for judgement in self.judgements)

    @property
    def verifications(self) -> Int[np.ndarray, " E"]:
        return np.array([judgement.verifications for judgement in self.judgements])

    @property
    def errors(self) -> tuple[str | None, ...]:
        """Why a world's defender failed in this frame; None where it did not."""
        return tuple(judgement.error for judgement in self.judgements)


@dataclass(frozen=True, eq=False, kw_only=True)
class Outcome(SimulatedOutcome):
    """A frame that was played."""

    truth: tuple[Float[np.ndarray, "_ 5"], ...]  # every vehicle in range, seen or hidden; ego frame
    seconds: float = 0.0  # what the step took for all worlds: perceiving and defending, not attacking
    traffic: tuple[tuple[Scene, int, float], ...] = ()  # scene, its frame, reach of the map; m

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "truth", tuple(frozen(boxes) for boxes in self.truth))
        traffic = tuple((frozen_scene(scene), frame, extent) for scene, frame, extent in self.traffic)
        object.__setattr__(self, "traffic", traffic)

    @cached_property
    def surroundings(self) -> tuple[Surroundings, ...]:
        """The true traffic round each ego, with velocities and the ego's corridor; computed when it is asked for.

        Raises:
            ValueError: the outcome was made by hand, without `traffic`.
        """
        return tuple(copy.copy(around) for around in self._traffic_around)

    @cached_property
    def _traffic_around(self) -> tuple[Surroundings, ...]:
        """The referee's own: what is computed of them is kept for all later outcomes of their frame."""
        if len(self.traffic) != len(self.truth):
            raise ValueError(
                "driving measures need the outcome's `traffic`: give (scene, frame, extent) for each world"
            )
        return tuple(surroundings(scene, frame, extent) for scene, frame, extent in self.traffic)

    @cached_property
    def _driving(self) -> DrivingMeasures:
        boxes = [judgement.output.seen.boxes for judgement in self.judgements]
        return DrivingMeasures(boxes, self.clean, self._traffic_around)

    @property
    def critical(self) -> Int[np.ndarray, "E 2"]:
        """How many critical vehicles the output finds, and how many there are; see `metrics.critical`."""
        return self._driving.critical

    @property
    def miss_severity(self) -> Float[np.ndarray, " E"]:
        """The hardest braking that a vehicle demands which the output misses; m/s². See `metrics.severity`."""
        return self._driving.miss_severity

    @property
    def ghost_severity(self) -> Float[np.ndarray, " E"]:
        """The hardest braking that a ghost of the output demands; m/s²."""
        return self._driving.ghost_severity

    @property
    def removable(self) -> Bool[np.ndarray, " E"]:
        """Whether the nearest vehicle is found in the clean view; see `metrics.targeted`."""
        return self._driving.removable

    @property
    def removed(self) -> Bool[np.ndarray, " E"]:
        """Whether it is, and is missing in the output."""
        return self._driving.removed

    @property
    def spoofed(self) -> Bool[np.ndarray, " E"]:
        """Whether the output holds a critical ghost that the clean view does not hold."""
        return self._driving.spoofed

    @property
    def decodes(self) -> Int[np.ndarray, " E"]:
        """How many groups were perceived: everyone, those asked, and the output's; each once."""
        return np.array(
            [
                len({seen.group, judgement.output.group, *(group & seen.group for group in judgement.groups)})
                for seen, judgement in zip(self.seen, self.judgements, strict=True)
            ]
        )


FRAME_METRICS: dict[str, Callable[[Outcome], Float[np.ndarray, " E"]]] = {
    "damage": lambda outcome: outcome.damage,
    "verifications": lambda outcome: outcome.verifications,
    "similarity": lambda outcome: outcome.similarity,
    "frame": lambda outcome: outcome.frame,
    "suspects": lambda outcome: np.array([len(verdict.suspects) for verdict in outcome.verdicts]),
    "collaborators": lambda outcome: np.array([len(verdict.collaborators) for verdict in outcome.verdicts]),
    "converged": lambda outcome: np.array([verdict.converged for verdict in outcome.verdicts]),
    "failed": lambda outcome: np.array([error is not None for error in outcome.errors]),
    "decodes": lambda outcome: outcome.decodes,
    "critical": lambda outcome: outcome.critical[:, 1],
    "critical_missed": lambda outcome: outcome.critical[:, 1] - outcome.critical[:, 0],
    "miss_severity": lambda outcome: outcome.miss_severity,
    "ghost_severity": lambda outcome: outcome.ghost_severity,
    "removed": lambda outcome: outcome.removed,
    "spoofed": lambda outcome: outcome.spoofed,
}
"""One number a world and frame. Infos, observations and records read an outcome through this table."""


def clean_output(
    places: Sequence[tuple[Episode, int]],
    detector: DetectorLike,
    receive: Callable[[], Float[Tensor, "E N C H W"]],
    coverage: Float[Tensor, "E N H W"],
    present: Bool[Tensor, "E N"],
) -> Dense:
    """The decoder's output without an attack. With everyone present it was stored; else it is perceived anew."""
    logits = torch.stack([episode.clean.logits[t] for episode, t in places]).float().to(coverage.device)
    boxes = torch.stack([episode.clean.boxes[t] for episode, t in places]).float().to(coverage.device)
    few = torch.nonzero(~present.all(1)).flatten()
    if len(few):
        with torch.inference_mode():
            dense = detector.perceive(receive(), coverage, few, present[few])
        logits[few], boxes[few] = dense.logits.clone(), dense.boxes.clone()
    return Dense(logits, boxes)
