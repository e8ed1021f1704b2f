"""Untargeted objectives of an attack: hide, spoof or both; and all objectives by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from agents.attacks.objectives.detection import DetectionLoss
from agents.attacks.objectives.targeted import plant, remove
from agents.attacks.spec import named
from agents.attacks.targets import AttackTargets, Objective, ViewLoss
from cp_env.perturbation.objective import distance_from


@dataclass(frozen=True)
class UntargetedObjective:
    """Weights of the three parts of `adversarial_loss`, PRBI Eq. (2).

    Args:
        hide: conceal what is there.
        spoof: invent what is not.
        drift: displace boxes.
    """

    hide: float = 1.0
    spoof: float = 1.0
    drift: float = 1.0

    def __call__(self, targets: AttackTargets) -> ViewLoss:
        return distance_from(targets.clean, hide=self.hide, spoof=self.spoof, drift=self.drift)


OBJECTIVES: dict[str, Callable[..., Objective]] = {
    "both": UntargetedObjective,
    "hide": partial(UntargetedObjective, 1.0, 0.0, 0.0),
    "spoof": partial(UntargetedObjective, 0.0, 1.0, 0.0),
    "detection_loss": DetectionLoss,
    "remove": remove,
    "plant": plant,
}


def make_objective(objective: str | Objective) -> Objective:
    """An objective by name, or the function itself.

    Args:
        objective: `both`, `hide`, `spoof`, `detection_loss`, `remove@3`, `remove@12.5:-3`, `plant@10:4:0.5` (see
            `agents.attacks.objectives`), or an objective.

    Returns:
        The objective.

    Raises:
        ValueError: an unknown name, or numbers that it does not take.
    """
    return named("objective", objective, OBJECTIVES) if isinstance(objective, str) else objective
