"""What the liars of one frame want: to hide, to spoof, both, or one chosen car."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from agents.attacks.objectives.targeted import plant, remove
from agents.attacks.spec import named
from agents.attacks.targets import Goal, Score, Views
from cp_env.perturbation.objective import distance_from


@dataclass(frozen=True)
class Objective:
    """Untargeted: weights of the three parts of `adversarial_loss`, PRBI Eq. (2): conceal, invent, displace."""

    hide: float = 1.0
    spoof: float = 1.0
    drift: float = 1.0

    def __call__(self, views: Views) -> Score:
        return distance_from(views.clean, hide=self.hide, spoof=self.spoof, drift=self.drift)


OBJECTIVES: dict[str, Callable[..., Goal]] = {
    "both": Objective,
    "hide": partial(Objective, 1.0, 0.0, 0.0),
    "spoof": partial(Objective, 0.0, 1.0, 0.0),
    "remove": remove,
    "plant": plant,
}


def make_objective(objective: str | Goal) -> Goal:
    """`both`, `hide`, `spoof`, `remove@3`, `remove@12.5:-3`, `plant@10:4:0.5`; or itself."""
    return named("objective", objective, OBJECTIVES) if isinstance(objective, str) else objective
