"""Boiling the frog: a lie that grows slower than anyone looks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from agents.attacks.gradient import Ascent
from agents.attacks.objectives.scene_target import Picture, crossings
from agents.attacks.pgd import Steepest
from agents.protocol import Attacker


@dataclass(frozen=True)
class Ramp:
    """An `Allowance`: the share of Δ is `first` in frame `onset`, and `rate` more with every frame, up to `ceiling`."""

    rate: float
    first: float = 0.0
    onset: int = 1
    ceiling: float = 1.0

    def __post_init__(self) -> None:
        if not (self.rate > 0 and 0 <= self.first <= self.ceiling <= 1 and self.onset >= 0):
            raise ValueError(
                "a ramp needs rate > 0, 0 <= first <= ceiling <= 1 and onset >= 0; got "
                f"rate={self.rate}, first={self.first}, ceiling={self.ceiling}, onset={self.onset}"
            )

    def __call__(self, frame: Int[np.ndarray, " E"]) -> Float[np.ndarray, " E"]:
        share = np.minimum(self.first + self.rate * (frame - self.onset), self.ceiling)
        return np.where(frame >= self.onset, share, 0.0).astype(np.float32)


def ramp(
    rate: float = 0.3,
    first: float = 0.2,
    onset: int = 1,
    ceiling: float = 1.0,
    spacing: float = 12.0,
    steps: int = 15,
    step_size: float = 0.1,
) -> Attacker:
    """Liars whose strength rises so slowly that each frame resembles the one before.

    Threat model: white-box on the detector; of the defence they know no more than that it compares a frame with the
    last one (PRBI, bayes), neither ε nor its state. Each output becomes the next reference, so a lie that was let
    through covers the next, somewhat larger one. Source: the "boiling frog" poisoning of anomaly detectors (Rubinstein
    et al., "ANTIDOTE", 2009), which raises the chaff by a rate from week to week. What grows here is the share of Δ,
    towards one picture: ghosts `spacing` m apart that stand still in the world
    (`agents.attacks.objectives.scene_target`).
    """
    return Ascent(
        Steepest(steps, step_size),
        random_start=False,
        objective=Picture(crossings(spacing)),
        audience="fused",
        allowance=Ramp(rate, first, onset, ceiling),
    )
