"""What is known of a frame before anyone acts, and after everyone judged."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, Shaped
from torch import Tensor

from cp_env.detector.model.decoder import Dense
from cp_env.detector.protocol import DetectorLike, with_ego_context
from cp_env.types import View, frozen
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
    received: Float[Tensor, "E N C H W"]  # the same in the ego frame, before any perturbation
    coverage: Float[Tensor, "E N H W"]
    ego_T_sender: Float[Tensor, "E N 3"]  # m, m, rad
    clean: Dense  # the decoder's output with everyone fused and no attack
    attackers: Int[Tensor, "E k"]
    fused: Bool[Tensor, "E N"]  # expected collaborators: all, until a verdict that has converged leaves some out
    present: Bool[Tensor, "E N"]  # vehicles that send a map; perturbations of others are dropped
    active: Bool[Tensor, " E"]  # False in grace frames: perturbations are dropped
    frame: Int[np.ndarray, " E"]  # since the episode began
    budget: float  # Δ
    norm: str
    detector: DetectorLike
    place: Float[np.ndarray, "E 2"]  # where the egos stand in the world; m
    output: tuple[View | None, ...]  # what they acted on in the last frame; None in the first
    verdict: tuple[Verdict | None, ...]  # of the last frame
    simulate: Callable[[Float[Tensor, "E k C H W"], Sequence[np.random.Generator]], SimulatedOutcome]
    ego_context: Shaped[Tensor, "E ..."] | None = None  # of the egos, if the detector uses it

    def handed_out(self) -> Situation:
        """The same with copies of all tensors and arrays: what an attack does to them changes nothing here."""
        copies: dict[str, Any] = {}
        for one in fields(self):
            value = getattr(self, one.name)
            if isinstance(value, Tensor):
                copies[one.name] = value.clone()
            elif isinstance(value, np.ndarray):
                copies[one.name] = value.copy()
        copies["clean"] = Dense(self.clean.logits.clone(), self.clean.boxes.clone())
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

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "truth", tuple(frozen(boxes) for boxes in self.truth))


FRAME_METRICS: dict[str, Callable[[Outcome], Float[np.ndarray, " E"]]] = {
    "damage": lambda outcome: outcome.damage,
    "verifications": lambda outcome: outcome.verifications,
    "similarity": lambda outcome: outcome.similarity,
    "frame": lambda outcome: outcome.frame,
    "suspects": lambda outcome: np.array([len(verdict.suspects) for verdict in outcome.verdicts]),
    "collaborators": lambda outcome: np.array([len(verdict.collaborators) for verdict in outcome.verdicts]),
    "converged": lambda outcome: np.array([verdict.converged for verdict in outcome.verdicts]),
    "failed": lambda outcome: np.array([error is not None for error in outcome.errors]),
}
"""One number a world and frame. Infos, observations and records read an outcome through this table."""


def clean_output(
    places: Sequence[tuple[Episode, int]],
    detector: DetectorLike,
    received: Float[Tensor, "E N C H W"],
    coverage: Float[Tensor, "E N H W"],
    present: Bool[Tensor, "E N"],
) -> Dense:
    """The decoder's output without an attack. With everyone present it was stored; else it is perceived anew."""
    logits = torch.stack([episode.clean.logits[t] for episode, t in places]).float().to(received.device)
    boxes = torch.stack([episode.clean.boxes[t] for episode, t in places]).float().to(received.device)
    few = torch.nonzero(~present.all(1)).flatten()
    if len(few):
        with torch.inference_mode():
            dense = detector.perceive(received, coverage, few, present[few])
        logits[few], boxes[few] = dense.logits.clone(), dense.boxes.clone()
    return Dense(logits, boxes)
