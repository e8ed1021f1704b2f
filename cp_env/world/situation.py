"""What is known of a frame before anyone acts, and after everyone judged."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped
from torch import Tensor

from cp_env.detector.model.decoder import Dense
from cp_env.detector.protocol import DetectorLike, at_side
from cp_env.types import View
from cp_env.world.verification import Judgement
from defenders.protocol import Verdict


@dataclass(frozen=True, eq=False)
class Situation:
    """The current frame before anyone acts: all that a white-box attacker may know. First axis: worlds.

    That includes the defence, by what the ego did in the last frame (`output`, `verdict`) and by `rehearse`: what would
    come of a δ if it were played now. It judges by copies of the defenders as they are, their algorithm and all they
    hold in mind, but their coins fall as the attacker's own generators say: one a world. No defender changes by it.
    """

    features: Callable[[], Float[Tensor, "E N C H W"]]  # encoded maps, sender frames; read on demand
    received: Float[Tensor, "E N C H W"]  # the same in the ego frame, nobody lying yet
    coverage: Float[Tensor, "E N H W"]
    ego_T_sender: Float[Tensor, "E N 3"]  # m, m, rad
    clean: Dense  # the decoder's output with everyone fused and nobody lying
    attackers: Int[Tensor, "E k"]
    fused: Bool[
        Tensor, "E N"
    ]  # whom the ego is expected to fuse: all, until a verdict that has converged leaves some out
    present: Bool[Tensor, "E N"]  # whose maps are there; perturbations of others are dropped
    active: Bool[Tensor, " E"]  # False in grace frames: perturbations are dropped
    frame: Int[np.ndarray, " E"]  # since the episode began
    budget: float  # Δ
    norm: str
    detector: DetectorLike
    place: Float[np.ndarray, "E 2"]  # where the egos stand in the world; m
    output: tuple[View | None, ...]  # what they acted on in the last frame; None in the first
    verdict: tuple[Verdict | None, ...]  # of the last frame
    rehearse: Callable[[Float[Tensor, "E k C H W"], Sequence[np.random.Generator]], Outcome]
    kept: Shaped[Tensor, "E ..."] | None = None  # what the egos keep of their own sweeps, if the detector asks for it

    def eyes(self, worlds: Int[Tensor, " B"] | slice = slice(None)) -> DetectorLike:
        """The detector with which the egos of `worlds` perceive: for rows of `received[worlds]`."""
        return at_side(self.detector, None if self.kept is None else self.kept[worlds])


@dataclass(frozen=True, eq=False)
class Outcome:
    """One frame of every world, after the defenders judged it. Sequences and first axes run over worlds."""

    frame: Int[np.ndarray, " E"]
    seen: tuple[View, ...]  # everyone fused, liars included
    clean: tuple[View, ...]  # everyone fused, as it would have been without lies
    judgements: tuple[Judgement, ...]
    truth: tuple[Float[np.ndarray, "_ 5"], ...]
    similarity: Float[np.ndarray, " E"]  # Eq. (5) of `seen` to the previous output; 1 in the first frame
    damage: Float[np.ndarray, " E"]  # 1 - Jaccard(output, clean)
    perturbation_norm: Float[np.ndarray, "E k"]
    attackers: Int[np.ndarray, "E k"]
    truncated: Bool[np.ndarray, " E"]

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
