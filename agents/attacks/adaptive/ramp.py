"""A slow ramp: a perturbation that grows too slowly for a comparison of consecutive frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from agents.attacks.gradient import GradientAttack
from agents.attacks.objectives.scene_target import SceneTarget, lattice_ghosts
from agents.attacks.pgd import ProjectedGradient
from agents.protocol import Attack


@dataclass(frozen=True)
class Ramp:
    """A `BudgetSchedule`: the share of Δ is `first` in frame `onset` and grows by `rate` a frame, up to `ceiling`.

    Args:
        rate: growth of the share a frame.
        first: the share in frame `onset`.
        onset: the first frame under attack.
        ceiling: the largest share.
    """

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
) -> Attack:
    """An attack whose strength rises so slowly that each frame resembles the one before.

    Threat model: white-box on the detector. Of the defence the attackers know only that it compares a frame with the
    last one (PRBI, bayes), neither ε nor its state. Each output becomes the next reference, so a perturbation that
    passed hides the next, somewhat larger one. Source: the "boiling frog" poisoning of anomaly detectors (Rubinstein et
    al., "ANTIDOTE", 2009), which raises the chaff by a rate from week to week. What grows here is the share of Δ,
    towards one scene: ghosts that stand still in the world (`agents.attacks.objectives.scene_target`).

    Args:
        rate: growth of the share of Δ a frame.
        first: the share in frame `onset`.
        onset: the first frame under attack.
        ceiling: the largest share.
        spacing: of the ghosts, m.
        steps: of the ascent.
        step_size: length of a step in the ball's norm.

    Returns:
        The attack.
    """
    return GradientAttack(
        ProjectedGradient(steps, step_size),
        random_start=False,
        objective=SceneTarget(lattice_ghosts(spacing)),
        target_groups="fused",
        budget_schedule=Ramp(rate, first, onset, ceiling),
    )
